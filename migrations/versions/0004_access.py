"""API keys, the audit trail, first answers by Idempotency-Key, and who posted an entry.

Revision ID: 0004
Revises: 0003
"""

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None

NAME = sa.String(length=200)
BIG = sa.BigInteger().with_variant(sa.Integer(), "sqlite")


def upgrade() -> None:
    op.add_column("event", sa.Column("posted_by", sa.String(length=40), nullable=True))
    op.create_table(
        "api_key",
        sa.Column("id", sa.String(length=40), nullable=False),
        sa.Column("name", NAME, nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("scopes", sa.Text(), nullable=False),
        sa.Column("rotors", sa.Text(), nullable=True),
        sa.Column("created_at", sa.Double(), nullable=False),
        sa.Column("expires_at", sa.Double(), nullable=True),
        sa.Column("revoked_at", sa.Double(), nullable=True),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_api_key")),
    )
    op.create_table(
        "audit",
        sa.Column("id", BIG, autoincrement=True, nullable=False),
        sa.Column("at", sa.Double(), nullable=False),
        sa.Column("key_id", sa.String(length=40), nullable=True),
        sa.Column("who", NAME, nullable=False),
        sa.Column("address", NAME, nullable=True),
        sa.Column("request_id", NAME, nullable=False),
        sa.Column("what", NAME, nullable=False),
        sa.Column("path", sa.Text(), nullable=False),
        sa.Column("rotor_id", NAME, nullable=True),
        sa.Column("first_seq", BIG, nullable=True),
        sa.Column("last_seq", BIG, nullable=True),
        sa.Column("status", sa.Integer(), nullable=False),
        sa.Column("problem", sa.String(length=60), nullable=True),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_audit")),
    )
    op.create_index("ix_audit_rotor_id_id", "audit", ["rotor_id", "id"], unique=False)
    op.create_index("ix_audit_key_id_id", "audit", ["key_id", "id"], unique=False)
    op.create_table(
        "first_answer",
        sa.Column("owner", sa.String(length=40), nullable=False),
        sa.Column("key", sa.String(length=64), nullable=False),
        sa.Column("fingerprint", sa.String(length=64), nullable=False),
        sa.Column("status", sa.Integer(), nullable=True),
        sa.Column("headers", sa.Text(), nullable=True),
        sa.Column("body", sa.LargeBinary(), nullable=True),
        sa.Column("begun_at", sa.Double(), nullable=False),
        sa.Column("expires_at", sa.Double(), nullable=False),
        sa.PrimaryKeyConstraint("owner", "key", name=op.f("pk_first_answer")),
    )
    op.create_index("ix_first_answer_expires_at", "first_answer", ["expires_at"], unique=False)


def downgrade() -> None:
    op.drop_index("ix_first_answer_expires_at", table_name="first_answer")
    op.drop_table("first_answer")
    op.drop_index("ix_audit_key_id_id", table_name="audit")
    op.drop_index("ix_audit_rotor_id_id", table_name="audit")
    op.drop_table("audit")
    op.drop_table("api_key")
    op.drop_column("event", "posted_by")
