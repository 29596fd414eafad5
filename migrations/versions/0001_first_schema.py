"""First schema: models, jobs, rotors, the inspection log, cursors, states, outbox.

Revision ID: 0001
Revises:
"""

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None

NAME = sa.String(length=200)
BIG = sa.BigInteger().with_variant(sa.Integer(), "sqlite")


def upgrade() -> None:
    op.create_table(
        "job",
        sa.Column("id", NAME, nullable=False),
        sa.Column("kind", sa.String(length=40), nullable=False),
        sa.Column("status", sa.String(length=20), nullable=False),
        sa.Column("request", sa.Text(), nullable=False),
        sa.Column("result", sa.Text(), nullable=True),
        sa.Column("error", sa.Text(), nullable=True),
        sa.Column("attempts", sa.Integer(), nullable=False),
        sa.Column("fence", BIG, nullable=False),
        sa.Column("owner", NAME, nullable=True),
        sa.Column("lease_until", sa.Double(), nullable=True),
        sa.Column("not_before", sa.Double(), nullable=True),
        sa.Column("created_at", sa.Double(), nullable=False),
        sa.Column("finished_at", sa.Double(), nullable=True),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_job")),
    )
    op.create_index("ix_job_status_created_at", "job", ["status", "created_at"], unique=False)
    op.create_table(
        "model",
        sa.Column("id", NAME, nullable=False),
        sa.Column("version", NAME, nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("source", sa.Text(), nullable=False),
        sa.Column("card", sa.Text(), nullable=False),
        sa.Column("created_at", sa.Double(), nullable=False),
        sa.PrimaryKeyConstraint("id", "version", name=op.f("pk_model")),
    )
    op.create_table(
        "rotor",
        sa.Column("id", NAME, nullable=False),
        sa.Column("model_id", NAME, nullable=False),
        sa.Column("model_version", NAME, nullable=False),
        sa.Column("particles", sa.Integer(), nullable=False),
        sa.Column("seed", BIG, nullable=False),
        sa.Column("head_seq", BIG, nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("created_at", sa.Double(), nullable=False),
        sa.ForeignKeyConstraint(
            ["model_id", "model_version"],
            ["model.id", "model.version"],
            name=op.f("fk_rotor_model_id"),
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_rotor")),
    )
    op.create_table(
        "blade",
        sa.Column("rotor_id", NAME, nullable=False),
        sa.Column("id", NAME, nullable=False),
        sa.Column("slot", NAME, nullable=True),
        sa.Column("lot", NAME, nullable=True),
        sa.Column("coating_lot", NAME, nullable=True),
        sa.Column("installed_at", NAME, nullable=True),
        sa.Column("time_h0", sa.Double(), nullable=True),
        sa.Column("added_seq", BIG, nullable=False),
        sa.Column("retired_seq", BIG, nullable=True),
        sa.ForeignKeyConstraint(["rotor_id"], ["rotor.id"], name=op.f("fk_blade_rotor_id")),
        sa.PrimaryKeyConstraint("rotor_id", "id", name=op.f("pk_blade")),
    )
    op.create_table(
        "cursor",
        sa.Column("rotor_id", NAME, nullable=False),
        sa.Column("applied_seq", BIG, nullable=False),
        sa.Column("version", BIG, nullable=False),
        sa.Column("dirty", sa.Boolean(), nullable=False),
        sa.Column("dirty_since", sa.Double(), nullable=True),
        sa.Column("fence", BIG, nullable=False),
        sa.Column("owner", NAME, nullable=True),
        sa.Column("lease_until", sa.Double(), nullable=True),
        sa.Column("sealing", sa.Boolean(), nullable=False),
        sa.Column("not_before", sa.Double(), nullable=True),
        sa.Column("attempts", sa.Integer(), nullable=False),
        sa.Column("blocked", sa.Boolean(), nullable=False),
        sa.Column("last_error", sa.Text(), nullable=True),
        sa.Column("last_error_event", NAME, nullable=True),
        sa.ForeignKeyConstraint(["rotor_id"], ["rotor.id"], name=op.f("fk_cursor_rotor_id")),
        sa.PrimaryKeyConstraint("rotor_id", name=op.f("pk_cursor")),
    )
    op.create_index("ix_cursor_dirty_dirty_since", "cursor", ["dirty", "dirty_since"], unique=False)
    op.create_table(
        "event",
        sa.Column("rotor_id", NAME, nullable=False),
        sa.Column("seq", BIG, autoincrement=False, nullable=False),
        sa.Column("event_id", sa.String(length=240), nullable=False),
        sa.Column("kind", sa.String(length=20), nullable=False),
        sa.Column("replaces", NAME, nullable=True),
        sa.Column("blade", NAME, nullable=True),
        sa.Column("time_h", sa.Double(), nullable=True),
        sa.Column("body", sa.Text(), nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("received_at", sa.Double(), nullable=False),
        sa.ForeignKeyConstraint(["rotor_id"], ["rotor.id"], name=op.f("fk_event_rotor_id")),
        sa.PrimaryKeyConstraint("rotor_id", "seq", name=op.f("pk_event")),
        sa.UniqueConstraint("rotor_id", "event_id", name=op.f("uq_event_rotor_id_event_id")),
    )
    op.create_index("ix_event_rotor_id_replaces", "event", ["rotor_id", "replaces"], unique=False)
    op.create_table(
        "outbox",
        sa.Column("id", BIG, autoincrement=True, nullable=False),
        sa.Column("rotor_id", NAME, nullable=False),
        sa.Column("kind", sa.String(length=20), nullable=False),
        sa.Column("payload", sa.Text(), nullable=False),
        sa.Column("at", sa.Double(), nullable=False),
        sa.ForeignKeyConstraint(["rotor_id"], ["rotor.id"], name=op.f("fk_outbox_rotor_id")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_outbox")),
    )
    op.create_index("ix_outbox_rotor_id_id", "outbox", ["rotor_id", "id"], unique=False)
    op.create_table(
        "state",
        sa.Column("rotor_id", NAME, nullable=False),
        sa.Column("version", BIG, autoincrement=False, nullable=False),
        sa.Column("through_seq", BIG, nullable=False),
        sa.Column("model_id", NAME, nullable=False),
        sa.Column("model_version", NAME, nullable=False),
        sa.Column("algorithm_version", NAME, nullable=False),
        sa.Column("sealed", sa.Boolean(), nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("events_digest", sa.String(length=64), nullable=False),
        sa.Column("meta", sa.Text(), nullable=False),
        sa.Column("created_at", sa.Double(), nullable=False),
        sa.ForeignKeyConstraint(["rotor_id"], ["rotor.id"], name=op.f("fk_state_rotor_id")),
        sa.PrimaryKeyConstraint("rotor_id", "version", name=op.f("pk_state")),
    )
    op.create_table(
        "state_array",
        sa.Column("rotor_id", NAME, nullable=False),
        sa.Column("name", NAME, nullable=False),
        sa.Column("version", BIG, autoincrement=False, nullable=False),
        sa.Column("encoding", sa.String(length=20), nullable=False),
        sa.Column("dtype", sa.String(length=20), nullable=False),
        sa.Column("shape", sa.String(length=100), nullable=False),
        sa.Column("sha256", sa.String(length=64), nullable=False),
        sa.Column("data", sa.LargeBinary(), nullable=False),
        sa.ForeignKeyConstraint(["rotor_id"], ["rotor.id"], name=op.f("fk_state_array_rotor_id")),
        sa.PrimaryKeyConstraint("rotor_id", "name", "version", name=op.f("pk_state_array")),
    )
    if op.get_bind().dialect.name == "postgresql":
        op.execute("ALTER TABLE state_array ALTER COLUMN data SET STORAGE EXTERNAL")


def downgrade() -> None:
    op.drop_table("state_array")
    op.drop_table("state")
    op.drop_index("ix_outbox_rotor_id_id", table_name="outbox")
    op.drop_table("outbox")
    op.drop_index("ix_event_rotor_id_replaces", table_name="event")
    op.drop_table("event")
    op.drop_index("ix_cursor_dirty_dirty_since", table_name="cursor")
    op.drop_table("cursor")
    op.drop_table("blade")
    op.drop_table("rotor")
    op.drop_table("model")
    op.drop_index("ix_job_status_created_at", table_name="job")
    op.drop_table("job")
