"""Effects that are adopted into a rotor's model; residuals as they are computed.

Revision ID: 0006
Revises: 0005
"""

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None


def upgrade() -> None:
    never = sa.Column("adopt", sa.String(length=20), server_default="never", nullable=False)
    op.add_column("rotor", never)
    columns = ["rotor_id", "kind", "seq"]
    op.create_index("ix_event_rotor_id_kind_seq", "event", columns, unique=False)


def downgrade() -> None:
    op.drop_index("ix_event_rotor_id_kind_seq", table_name="event")
    op.drop_column("rotor", "adopt")
