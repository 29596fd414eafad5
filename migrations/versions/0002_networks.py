"""A rotor's own network, a blade's known inputs, and since when a rotor is provisional.

Revision ID: 0002
Revises: 0001
"""

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("rotor", sa.Column("network", sa.Text(), nullable=True))
    op.add_column("blade", sa.Column("known", sa.Text(), nullable=True))
    op.add_column("cursor", sa.Column("provisional_since", sa.Double(), nullable=True))


def downgrade() -> None:
    op.drop_column("cursor", "provisional_since")
    op.drop_column("blade", "known")
    op.drop_column("rotor", "network")
