"""Whether a rotor's residuals ask for diagnoses by themselves, and of what they were judged.

Revision ID: 0014
Revises: 0013
"""

import sqlalchemy as sa
from alembic import op

revision = "0014"
down_revision = "0013"
branch_labels = None
depends_on = None

# To them a rotor with the option would be a damaged one: they do not have it in its digest.
OLDER_MAY_RUN = False

BIG = sa.BigInteger().with_variant(sa.Integer(), "sqlite")


def upgrade() -> None:
    never = sa.Column("diagnose", sa.String(length=20), server_default="never", nullable=False)
    op.add_column("rotor", never)
    op.add_column("residual", sa.Column("judged", BIG, server_default="0", nullable=False))
    op.add_column("residual", sa.Column("asked", sa.Text(), nullable=True))


def downgrade() -> None:
    op.drop_column("residual", "asked")
    op.drop_column("residual", "judged")
    op.drop_column("rotor", "diagnose")
