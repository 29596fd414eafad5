"""Runs the migrations on the connection that the caller opened (service.store.migrate)."""

from alembic import context

from service.store import access_tables, hook_tables, tables  # noqa: F401  the whole schema
from service.store.schema import metadata

connection = context.config.attributes["connection"]
context.configure(connection=connection, target_metadata=metadata, transactional_ddl=True)
with context.begin_transaction():
    context.run_migrations()
