"""How many deliveries of a webhook and rotor are not sent any more.

Revision ID: 0013
Revises: 0012
"""

import sqlalchemy as sa
from alembic import op

revision = "0013"
down_revision = "0012"
branch_labels = None
depends_on = None

# They could not delete a webhook that has a row here.
OLDER_MAY_RUN = False

NAME = sa.String(length=200)
BIG = sa.BigInteger().with_variant(sa.Integer(), "sqlite")


def upgrade() -> None:
    op.create_table(
        "untold",
        sa.Column("webhook_id", NAME, nullable=False),
        sa.Column("rotor_id", NAME, nullable=False),
        sa.Column("count", BIG, nullable=False),
        sa.Column("first_at", sa.Double(), nullable=False),
        sa.Column("last_at", sa.Double(), nullable=False),
        sa.ForeignKeyConstraint(["webhook_id"], ["webhook.id"], name=op.f("fk_untold_webhook_id")),
        sa.PrimaryKeyConstraint("webhook_id", "rotor_id", name=op.f("pk_untold")),
    )


def downgrade() -> None:
    op.drop_table("untold")
