"""What holds for every command: JSON, options in the table, completion, errors in one line."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from service.cli import app as commands

SERVICE = (Path(__file__).parents[2] / "service" / "README.md").read_text()
WITHOUT_JSON = {"worker"}
"""Prints nothing but its log."""


def walk(command: Any = None, name: str = "") -> Iterator[tuple[str, Any]]:
    """Every command that is shown, with its words."""
    command = get_command(commands) if command is None else command
    for inner, found in getattr(command, "commands", {}).items():
        if not found.hidden:
            yield from walk(found, f"{name} {inner}".strip())
    if not hasattr(command, "commands"):
        yield name, command


def options(command: Any) -> set[str]:
    """Its long options that are shown; what turns one off again need not be told."""
    shown = [p for p in command.params if p.param_type_name == "option" and not p.hidden]
    return {o for p in shown if p.name != "help" for o in p.opts if o.startswith("--")}


def documented() -> dict[str, set[str]]:
    """Options of each row of the tables of commands."""
    found: dict[str, set[str]] = {}
    for cell in re.findall(r"^\| `bladetwin ([^`]*)` \|", SERVICE, re.MULTILINE):
        words = re.match(r"[a-z]+(?: [a-z]+)*", cell)
        assert words is not None
        told = set(re.findall(r"--[a-z][a-z-]*", cell))
        found[words[0]] = found.get(words[0], set()) | told
    return found


def test_every_option_is_in_the_tables_and_no_other() -> None:
    rows = documented()
    for name, command in walk():
        own = {row: told for row, told in rows.items() if row == name or row.startswith(f"{name} ")}
        assert own, f"{name} has no row"
        told = set().union(*own.values())
        off = {o for p in command.params for o in p.secondary_opts}
        assert told - off == options(command) - off, name
    assert options(dict(walk())["serve"]) == {"--host", "--port", "--workers", "--json"}


def test_every_command_but_the_studies_can_print_json() -> None:
    """Studies write their figures as JSON into their folder."""
    without = {name for name, command in walk() if "--json" not in options(command)}
    assert {name for name in without if not name.startswith("study ")} == WITHOUT_JSON
    assert len(list(walk())) > 30


def bladetwin(
    *given: str, within: Sequence[str] = (), **environment: str
) -> subprocess.CompletedProcess[str]:
    """The installed command, by its entry point and under its name, called by another one."""
    code = "import sys; sys.argv[0] = 'bladetwin'; from service.cli import main; main()"
    return subprocess.run(
        [*within, sys.executable, "-c", code, *given], capture_output=True, text=True,
        env=os.environ | environment, timeout=120, check=False,
    )  # fmt: skip


def test_a_shell_completes_commands_options_and_their_values() -> None:
    asked = {"_BLADETWIN_COMPLETE": "complete_bash", "COMP_CWORD": "1"}
    assert bladetwin(COMP_WORDS="bladetwin exp", **asked).stdout.split() == ["export"]
    asked["COMP_CWORD"] = "5"
    values = bladetwin(COMP_WORDS="bladetwin export r1 file --format s", **asked)
    assert values.stdout.split() == ["sensorthings"]
    a_shell = ("bash", "-c", '"$@"; exit $?', "bash")  # which is asked for the shell it is
    shown = bladetwin("--show-completion", within=a_shell)
    assert "_BLADETWIN_COMPLETE" in shown.stdout + shown.stderr


@pytest.mark.parametrize(
    ("given", "environment", "status", "told"),
    [
        (["serve", "--hots", "x"], {}, 2, "No such option"),
        (["export", "none", "x.zip"], {}, 1, "rotor 'none' does not exist"),
        (["export", "none", "/proc/x", "--format", "csv"], {}, 1, "FILE = '/proc/x'"),
        (["inspect", "r1", "--url", "http://127.0.0.1:9"], {}, 1, "does not answer"),
        (["migrate"], {"BLADETWIN_WORKER": "3"}, 1, "BLADETWIN_WORKER"),
        (["migrate"], {"BLADETWIN_DATABASE_URL": "sqlite:////nowhere/x.db"}, 1, "database"),
        (["verify"], {"BLADETWIN_DATABASE_URL": "postgresql://127.0.0.1:9/x"}, 1, "database"),
        (
            ["migrate"],
            {"BLADETWIN_DATABASE_URL": "sqlite:////nowhere/x.db"},
            1,
            "sqlite:////nowhere/x.db does not answer: unable to open database file. To mend it: "
            "see that this user may write the file and its folder",
        ),
        (
            ["verify"],
            {"BLADETWIN_DATABASE_URL": "postgresql://me:secret@127.0.0.1:9/x"},
            1,
            "postgresql://me:***@127.0.0.1:9/x does not answer: connection failed: ",
        ),
    ],
)
def test_an_error_is_one_line_with_what_to_do_and_a_status(
    tmp_path: Path,
    sqlite_template: Path,
    given: list[str],
    environment: dict[str, str],
    status: int,
    told: str,
) -> None:
    shutil.copy(sqlite_template, tmp_path / "x.db")
    database = {"BLADETWIN_DATABASE_URL": f"sqlite:///{tmp_path / 'x.db'}"}
    done = bladetwin(*given, **database | {"BLADETWIN_SCIENCE": "fake"} | environment)
    assert done.returncode == status, done.stderr
    assert told in done.stderr
    assert "Traceback" not in done.stderr
    assert "secret" not in done.stderr
    if status == 1:
        assert done.stderr.count("\n") == 1, done.stderr
        assert done.stderr.startswith("bladetwin: ")


def test_json_is_one_object(tmp_path: Path) -> None:
    done = bladetwin("migrate", "--json", BLADETWIN_DATABASE_URL=f"sqlite:///{tmp_path / 'x.db'}")
    assert json.loads(done.stdout)["revision"]
