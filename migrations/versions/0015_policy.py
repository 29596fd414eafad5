"""What a rotor does by itself may be decided anew: the policy in force, with its digest.

Revision ID: 0015
Revises: 0014
"""

import sqlalchemy as sa
from alembic import op

revision = "0015"
down_revision = "0014"
branch_labels = None
depends_on = None

# An older worker would adopt by the option of the creation, though somebody forbade it since.
OLDER_MAY_RUN = False


def upgrade() -> None:
    op.add_column("rotor", sa.Column("adopt_now", sa.String(length=20), nullable=True))
    op.add_column("rotor", sa.Column("diagnose_now", sa.String(length=20), nullable=True))
    op.add_column("rotor", sa.Column("policy_at", sa.Double(), nullable=True))
    op.add_column("rotor", sa.Column("policy_digest", sa.String(length=64), nullable=True))


def downgrade() -> None:
    op.drop_column("rotor", "policy_digest")
    op.drop_column("rotor", "policy_at")
    op.drop_column("rotor", "diagnose_now")
    op.drop_column("rotor", "adopt_now")
