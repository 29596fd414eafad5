"""Webhooks and their deliveries.

Revision ID: 0007
Revises: 0005
"""

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"
branch_labels = None
depends_on = None

NAME = sa.String(length=200)
BIG = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
HEADS = ["webhook_id", "status", "rotor_id", "id"]


def upgrade() -> None:
    op.create_table(
        "webhook",
        sa.Column("id", NAME, nullable=False),
        sa.Column("url", sa.Text(), nullable=False),
        sa.Column("events", sa.Text(), nullable=False),
        sa.Column("rotors", sa.Text(), nullable=True),
        sa.Column("salt", sa.String(length=64), nullable=False),
        sa.Column("fingerprint", sa.String(length=64), nullable=False),
        sa.Column("created_at", sa.Double(), nullable=False),
        sa.Column("fence", BIG, nullable=False),
        sa.Column("owner", NAME, nullable=True),
        sa.Column("lease_until", sa.Double(), nullable=True),
        sa.Column("served_at", sa.Double(), nullable=True),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_webhook")),
    )
    op.create_table(
        "delivery",
        sa.Column("id", BIG, autoincrement=True, nullable=False),
        sa.Column("message_id", sa.String(length=60), nullable=False),
        sa.Column("webhook_id", NAME, nullable=False),
        sa.Column("rotor_id", NAME, nullable=False),
        sa.Column("event", sa.String(length=20), nullable=False),
        sa.Column("body", sa.Text(), nullable=False),
        sa.Column("status", sa.String(length=20), nullable=False),
        sa.Column("attempts", sa.Integer(), nullable=False),
        sa.Column("created_at", sa.Double(), nullable=False),
        sa.Column("not_before", sa.Double(), nullable=True),
        sa.Column("tried_at", sa.Double(), nullable=True),
        sa.Column("last_error", sa.Text(), nullable=True),
        sa.ForeignKeyConstraint(
            ["webhook_id"], ["webhook.id"], name=op.f("fk_delivery_webhook_id")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_delivery")),
        sa.UniqueConstraint("message_id", name=op.f("uq_delivery_message_id")),
    )
    op.create_index("ix_delivery_heads", "delivery", HEADS, unique=False)
    op.create_index("ix_delivery_webhook_id_id", "delivery", ["webhook_id", "id"], unique=False)


def downgrade() -> None:
    op.drop_index("ix_delivery_webhook_id_id", table_name="delivery")
    op.drop_index("ix_delivery_heads", table_name="delivery")
    op.drop_table("delivery")
    op.drop_table("webhook")
