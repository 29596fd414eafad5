"""What operating needs: origin of an imported rotor, counters of the cursor, two indices.

Revision ID: 0003
Revises: 0002
"""

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None

BIG = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
COUNTERS = ("takeovers", "seals", "outbox_dropped")
RECEIVED = ["rotor_id", "received_at", "seq"]
DIGESTS = ["rotor_id", "name", "version", "sha256"]


def upgrade() -> None:
    op.add_column("rotor", sa.Column("origin", sa.String(length=200), nullable=True))
    for name in COUNTERS:
        op.add_column("cursor", sa.Column(name, BIG, nullable=False, server_default="0"))
    op.add_column("cursor", sa.Column("ess_ratio", sa.Double(), nullable=True))
    op.create_index("ix_state_array_digests", "state_array", DIGESTS, unique=False)
    op.create_index("ix_event_received", "event", RECEIVED, unique=False)


def downgrade() -> None:
    op.drop_index("ix_event_received", table_name="event")
    op.drop_index("ix_state_array_digests", table_name="state_array")
    op.drop_column("cursor", "ess_ratio")
    for name in reversed(COUNTERS):
        op.drop_column("cursor", name)
    op.drop_column("rotor", "origin")
