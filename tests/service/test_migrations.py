"""The migrated schema is the declared one."""

from __future__ import annotations

from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.runtime.migration import MigrationContext
from sqlalchemy import text

from service.store import migrate as migrations
from service.store.engine import is_sqlite, open_engine, transaction
from service.store.tables import metadata


def test_a_migrated_database_differs_in_nothing_from_the_declared_tables(bare_url: str) -> None:
    engine = open_engine(bare_url)
    assert migrations.current(engine) is None
    migrations.migrate(engine)
    assert migrations.current(engine) == migrations.newest()
    with transaction(engine, write=False) as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True})
        assert compare_metadata(context, metadata) == []
    engine.dispose()


def test_the_comparison_would_notice_a_column_that_no_migration_makes(bare_url: str) -> None:
    engine = open_engine(bare_url)
    migrations.migrate(engine)
    with transaction(engine, write=True) as connection:
        connection.execute(text("ALTER TABLE rotor ADD COLUMN stray INTEGER"))
        context = MigrationContext.configure(connection, opts={"compare_type": True})
        assert [one[0] for one in compare_metadata(context, metadata)] == ["remove_column"]
    engine.dispose()


def test_array_bytes_are_stored_uncompressed_whichever_way_the_table_was_made(
    bare_url: str,
) -> None:
    engine = open_engine(bare_url)
    query = text(
        "SELECT attstorage FROM pg_attribute "
        "WHERE attrelid = 'state_array'::regclass AND attname = 'data'"
    )
    if is_sqlite(engine):
        query = text("SELECT 'e'")
    migrations.migrate(engine)
    with transaction(engine, write=True) as connection:
        assert connection.execute(query).scalar() == "e"
        metadata.drop_all(connection)
        metadata.create_all(connection)
        assert connection.execute(query).scalar() == "e"
    engine.dispose()


def test_a_second_migration_finds_nothing_to_do_and_a_downgrade_leaves_no_table(
    bare_url: str,
) -> None:
    engine = open_engine(bare_url)
    assert migrations.migrate(engine) == migrations.migrate(engine)
    with transaction(engine, write=True) as connection:
        command.downgrade(migrations._config(connection), "base")
        found = set(metadata.tables) & set(engine.dialect.get_table_names(connection))
        assert found == set()
    engine.dispose()
