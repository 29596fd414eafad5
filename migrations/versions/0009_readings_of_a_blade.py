"""Entries of one blade are found without going through its rotor's.

Revision ID: 0009
Revises: 0008
"""

from alembic import op

revision = "0009"
down_revision = "0008"
branch_labels = None
depends_on = None

NAME = "ix_event_rotor_id_blade_kind_seq"


def upgrade() -> None:
    op.create_index(NAME, "event", ["rotor_id", "blade", "kind", "seq"])


def downgrade() -> None:
    op.drop_index(NAME, "event")
