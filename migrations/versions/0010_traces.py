"""Entries and jobs keep the trace of the request that wrote them.

Revision ID: 0010
Revises: 0009
"""

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = "0009"
branch_labels = None
depends_on = None


def upgrade() -> None:
    for table in ("event", "job"):
        op.add_column(table, sa.Column("traceparent", sa.String(length=60), nullable=True))


def downgrade() -> None:
    for table in ("event", "job"):
        with op.batch_alter_table(table) as batch:
            batch.drop_column("traceparent")
