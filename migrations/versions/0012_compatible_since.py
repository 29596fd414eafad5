"""The oldest revision whose processes may run on this schema.

Revision ID: 0012
Revises: 0011
"""

import sqlalchemy as sa
from alembic import op

revision = "0012"
down_revision = "0011"
branch_labels = None
depends_on = None

# Processes from before do not look at the row that says so.
OLDER_MAY_RUN = False


def upgrade() -> None:
    op.create_table(
        "compatible_since",
        sa.Column("revision", sa.String(length=32), nullable=False),
        sa.PrimaryKeyConstraint("revision", name=op.f("pk_compatible_since")),
    )


def downgrade() -> None:
    op.drop_table("compatible_since")
