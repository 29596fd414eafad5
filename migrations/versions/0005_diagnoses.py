"""Jobs of a rotor, and how far a job is.

Revision ID: 0005
Revises: 0004
"""

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("job", sa.Column("rotor_id", sa.String(length=200), nullable=True))
    op.add_column("job", sa.Column("progress", sa.Text(), nullable=True))
    op.create_index("ix_job_rotor_id_id", "job", ["rotor_id", "id"], unique=False)


def downgrade() -> None:
    op.drop_index("ix_job_rotor_id_id", table_name="job")
    op.drop_column("job", "progress")
    op.drop_column("job", "rotor_id")
