"""Effects that are adopted into a rotor's model; residuals as they are computed.

Revision ID: 0006
Revises: 0005
"""

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None


def upgrade() -> None:
    never = sa.Column("adopt", sa.String(length=20), server_default="never", nullable=False)
    op.add_column("rotor", never)
    columns = ["rotor_id", "kind", "seq"]
    op.create_index("ix_event_rotor_id_kind_seq", "event", columns, unique=False)
    big = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
    op.create_table(
        "residual",
        sa.Column("rotor_id", sa.String(length=200), nullable=False),
        sa.Column("version", big, nullable=False),
        sa.Column("body", sa.Text(), nullable=True),
        sa.Column("alarms", sa.Integer(), nullable=False),
        sa.Column("computed_at", sa.Double(), nullable=True),
        sa.Column("fence", big, nullable=False),
        sa.Column("owner", sa.String(length=200), nullable=True),
        sa.Column("lease_until", sa.Double(), nullable=True),
        sa.Column("not_before", sa.Double(), nullable=True),
        sa.Column("attempts", sa.Integer(), nullable=False),
        sa.Column("error", sa.Text(), nullable=True),
        sa.ForeignKeyConstraint(["rotor_id"], ["rotor.id"], name="fk_residual_rotor_id"),
        sa.PrimaryKeyConstraint("rotor_id", name="pk_residual"),
    )


def downgrade() -> None:
    op.drop_table("residual")
    op.drop_index("ix_event_rotor_id_kind_seq", table_name="event")
    op.drop_column("rotor", "adopt")
