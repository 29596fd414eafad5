"""Commands that look at a database neither make one nor migrate it.

Nor do they take another program for the service.
"""

from __future__ import annotations

import threading
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest
from alembic import command
from typer.testing import CliRunner

from service.cli import app
from service.store import migrate as migrations
from service.store.engine import open_engine, transaction

LOOKS = [
    ["verify"],
    ["verify", "r1", "--repair"],
    ["replay", "r1"],
    ["export", "r1", "r1.zip"],
    ["export", "r1", "r1.csv", "--format", "csv"],
    ["umbridge", "r1", "B1"],
    ["keys", "list"],
    ["keys", "revoke", "k1"],
    ["audit"],
]
of_each = pytest.mark.parametrize("words", LOOKS, ids=" ".join)


def run(path: Path, words: list[str]) -> tuple[int, str]:
    environ = {"BLADETWIN_DATABASE_URL": f"sqlite:///{path}", "BLADETWIN_SCIENCE": "fake"}
    done = CliRunner().invoke(app, words, env=environ)
    return done.exit_code, str(done.exception)


@of_each
@pytest.mark.parametrize("empty", [False, True])
def test_in_a_wrong_folder_they_say_so_and_make_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], empty: bool
) -> None:
    """An empty database that was made there would be called sound, and backed up for years."""
    monkeypatch.chdir(tmp_path)
    if empty:
        Path("bladetwin.db").touch()
    code, told = run(Path("bladetwin.db"), words)
    assert code == 1
    assert str(tmp_path / "bladetwin.db") in told
    assert "To mend it: run it in the folder of the service" in told
    assert [(p.name, p.stat().st_size) for p in tmp_path.iterdir()] == [("bladetwin.db", 0)] * empty


@of_each
def test_an_older_schema_stays_for_the_release_that_runs_on_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    engine = open_engine("sqlite:///twin.db")
    with transaction(engine, write=True) as connection:
        command.upgrade(migrations._config(connection), "0001")
    code, told = run(Path("twin.db"), words)
    assert code == 1
    assert "has schema 0001" in told
    assert "run `bladetwin migrate`" in told
    assert migrations.current(engine) == "0001"
    engine.dispose()


class Page(BaseHTTPRequestHandler):
    """A proxy, or another program, that answers every path with its page."""

    body = b"<!doctype html><title>Welcome</title>"

    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Length", str(len(self.body)))
        self.end_headers()
        self.wfile.write(self.body)

    def log_message(self, *given: object) -> None:
        """Nothing."""


@pytest.mark.parametrize("body", [Page.body, b"{}", b"[1]", b'{"ready": false}', b""])
def test_another_program_that_answers_every_path_is_not_called_ready(body: bytes) -> None:
    """A health check at a wrong address would be green for as long as the service is down."""
    other = type("Other", (Page,), {"body": body})
    with HTTPServer(("127.0.0.1", 0), other) as server:
        thread = threading.Thread(target=server.handle_request)
        thread.start()
        address = f"http://127.0.0.1:{server.server_port}"
        done = CliRunner().invoke(app, ["health", "--url", address])
        thread.join()
    assert done.exit_code == 1
    assert "not bladetwin" in done.output
    assert "--url" in done.output


@pytest.mark.parametrize("words", [["inspect", "r1"], ["policy", "r1"]], ids=" ".join)
def test_asked_at_a_wrong_address_they_say_so(words: list[str]) -> None:
    with HTTPServer(("127.0.0.1", 0), Page) as server:
        thread = threading.Thread(target=server.handle_request)
        thread.start()
        address = f"http://127.0.0.1:{server.server_port}"
        done = CliRunner().invoke(app, [*words, "--url", address])
        thread.join()
    assert done.exit_code == 1
    assert f"{address} is not bladetwin. To mend it: give its --url" in str(done.exception)
