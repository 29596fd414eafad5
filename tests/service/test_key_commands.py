"""The commands for keys and the audit trail, and a real server that asks for keys."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import httpx
import pytest
from typer.testing import CliRunner

from service.cli import app
from service.client import Client, ProblemError
from service.free_port import free_port
from service.worker.supervise import same_code
from tests.patience import PATIENCE_S


@pytest.fixture
def environ(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """A new SQLite database that no command has touched yet."""
    given = {
        "BLADETWIN_DATABASE_URL": f"sqlite:///{tmp_path / 'b.db'}",
        "BLADETWIN_SCIENCE": "fake",
    }
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    return given


def run(*words: str) -> Any:
    done = CliRunner().invoke(app, [*words, "--json"], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)


def test_a_key_is_shown_once_and_listed_without_its_secret(environ: dict[str, str]) -> None:
    words = ["--scope", "ingest", "--scope", "read", "--rotor", "r2", "--rotor", "r1"]
    made = run("keys", "create", "plant gateway", *words, "--days", "30")
    token = made.pop("key")
    assert token.startswith(f"btk_{made['id']}_")
    assert (made["scopes"], made["rotors"]) == (["read", "ingest"], ["r1", "r2"])
    assert run("keys", "list")["items"] == [made]
    shown = CliRunner().invoke(app, ["keys", "create", "ops", "--scope", "operate"]).output
    assert "not shown again" in shown
    assert shown.count("btk_") == 2, "the key, and the first letters of how to send it"
    assert "all rotors; without end" in shown
    listed = CliRunner().invoke(app, ["keys", "list"]).output
    assert token.split("_", 2)[2] not in listed + json.dumps(run("keys", "list"))
    assert run("keys", "revoke", made["id"])["status"] == "revoked"
    again = CliRunner().invoke(app, ["keys", "revoke", made["id"]]).output
    assert "was already revoked" in again
    assert [one["status"] for one in run("keys", "list")["items"]] == ["revoked", "usable"]


def test_keys_that_are_made_and_revoked_stand_in_the_trail(environ: dict[str, str]) -> None:
    made = run("keys", "create", "ops", "--scope", "operate")
    run("keys", "revoke", made["id"])
    rows = run("audit")["items"]
    assert [row["path"] for row in rows] == [
        f"keys revoke {made['id']}",
        f"keys create {made['id']}",
    ]
    assert all(row["who"].startswith("command line, ") for row in rows)
    text = CliRunner().invoke(app, ["audit", "--limit", "1"]).output
    assert text.count("\n") == 1
    assert f"keys revoke {made['id']} 202" in text
    text = CliRunner().invoke(app, ["audit", "--rotor", "r9", "--key", "k"]).output
    assert text == "nothing is recorded of rotor 'r9' by key 'k'\n"
    assert run("audit", "--before", str(rows[0]["id"]))["items"] == rows[1:]


def test_a_real_server_asks_for_keys_and_tells_no_secret(
    environ: dict[str, str], tmp_path: Path
) -> None:
    port = free_port()
    command = [sys.executable, "-P", "-m", "service.cli", "serve", "--port", str(port)]
    command += ["--workers", "0"]
    given = same_code({**os.environ, **environ})
    everywhere = [*command, "--host", "0.0.0.0"]
    refused = subprocess.run(everywhere, env=given, capture_output=True, text=True, check=False)
    assert refused.returncode == 1
    assert "bladetwin keys create" in refused.stderr
    assert refused.stderr.count("\n") == 1
    token = run("keys", "create", "tests", "--scope", "read", "--scope", "operate")["key"]
    log = tmp_path / "serve.log"
    with log.open("wb") as out:
        always = given | {"BLADETWIN_KEYS": "always"}
        server = subprocess.Popen(command, env=always, stdout=out, stderr=out)
    try:
        url = f"http://127.0.0.1:{port}"
        with Client(url, key=token) as twin, Client(url) as stranger:
            twin.ready(PATIENCE_S)
            twin.create_rotor("r1", blades=["B1"])
            assert twin.rotor("r1")["id"] == "r1"
            with pytest.raises(ProblemError, match="401"):
                stranger.rotor("r1")
        answer = httpx.get(
            f"{url}/v1/rotors/{token}",
            headers={"Authorization": f"Bearer {token}"},
            timeout=PATIENCE_S,
        )
        assert (answer.status_code, answer.headers.get_list("server")) == (404, ["bladetwin"])
        assert answer.headers["ratelimit-policy"] == '"key";q=200;w=4'
    finally:
        server.send_signal(signal.SIGTERM)
        assert server.wait(PATIENCE_S) is not None
    lines = [json.loads(line) for line in log.read_text().splitlines() if line.startswith("{")]
    told = [line for line in lines if line["logger"] == "bladetwin.http"]
    assert {line["who"] for line in told if "who" in line} == {token.split("_")[1]}
    assert any("POST /v1/rotors 201" in line["message"] for line in told)
    assert token.split("_", 2)[2][:16] not in log.read_text()
    assert f"/v1/rotors/btk_{token.split('_')[1]}_" in log.read_text().encode().decode(
        "unicode_escape"
    )
