"""What a user can set, call or ask is in the README."""

from __future__ import annotations

import re
from pathlib import Path

import typer

from service.bootstrap import make_app, make_store, prepare
from service.cli import app as commands
from service.environment import table
from service.fake import FakeScience
from service.settings import Settings

README = (Path(__file__).parent.parent / "README.md").read_text()


def test_every_setting_is_named_with_its_default() -> None:
    missing = [
        name
        for name, default, _ in table(Settings)
        if f"`{name}` | `{default}`" not in README and f"`{name}` | empty" not in README
    ]
    assert missing == []


def test_the_two_commands_stand_in_the_readme() -> None:
    assert README.count("python3 -m venv") == 2
    assert "<!-- test command -->" in README
    assert "\nunset PYTHONDONTWRITEBYTECODE && python3" in README, "every start would compile anew"


def test_every_route_is_named_and_no_other(tmp_path: Path) -> None:
    settings = Settings(database_url=f"sqlite:///{tmp_path / 'x.db'}")
    store = make_store(settings)
    prepare(store, settings)
    paths = make_app(store, FakeScience(), settings).openapi()["paths"]
    store.close()
    served = {f"{method.upper()} {path}" for path, methods in paths.items() for method in methods}
    assert set(re.findall(r"`((?:GET|POST|PUT|PATCH|DELETE) /[^`?]*)`", README)) == served


def test_every_command_is_named_and_no_other() -> None:
    def words(group: typer.Typer, before: str) -> set[str]:
        found = set()
        for command in group.registered_commands:
            assert command.callback is not None
            if command.hidden:  # one that only `serve` calls
                continue
            found.add(f"{before} {command.name or command.callback.__name__}")
        for inner in group.registered_groups:
            assert inner.typer_instance is not None
            found |= words(inner.typer_instance, f"{before} {inner.name}")
        return found

    table_rows = re.findall(r"^\| `(bladetwin(?: [a-z]+)+)", README, re.MULTILINE)
    assert {" ".join(row.split()[:3]) for row in table_rows} == words(commands, "bladetwin")


PROBLEM = re.compile(r"""\b[45]\d\d,\s*["']([a-z]+(?:-[a-z]+)*)["']""")


def kinds(source: str) -> set[str]:
    """The kinds of problems that a module answers with."""
    routed = re.findall(r"kinds = {.*?}|kinds\.get\(.*?\)", source)
    return set(PROBLEM.findall(source)) | set(re.findall(r'"([a-z-]+)"', " ".join(routed)))


def test_every_kind_of_problem_is_named_and_no_other() -> None:
    root = Path(__file__).parent.parent / "service" / "api"
    served = set().union(*(kinds(path.read_text()) for path in root.rglob("*.py")))
    part = README.partition("| problem `urn:bladetwin:problem:…`")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| (`[^|]*`) \|", part, re.MULTILINE)
    assert {kind for row in rows for kind in re.findall(r"`([a-z-]+)`", row)} == served
    assert kinds('problem(request, 418, "short-and-stout", detail)') == {"short-and-stout"}
