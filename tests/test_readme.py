"""What a user can set, call or ask is in the documents, and the first of them can be read.

`README.md` is read first; routes, commands and settings are in `service/README.md`, runs of one's
own in `core/README.md`.
"""

from __future__ import annotations

import re
from pathlib import Path

import typer

from service.bootstrap import make_app, make_store, prepare
from service.cli import app as commands
from service.environment import table
from service.fake import FakeScience
from service.settings import Settings

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()
SERVICE = (ROOT / "service" / "README.md").read_text()
OTHERS = README + (ROOT / "core" / "README.md").read_text()
MOST_LINES = 480
LONGEST_LINE = 160


def test_the_first_document_is_of_human_size() -> None:
    """Commands are to be copied whole and tables have a line a row; all else is short lines."""
    assert README.count("\n") <= MOST_LINES
    told = re.sub(r"```.*?```", "", README, flags=re.DOTALL).splitlines()
    assert [line for line in told if len(line) > LONGEST_LINE and line[0] not in "|!"] == []


FIGURE = re.compile(r"\d(?:[\d.,:]*\d)?")


def rows(text: str) -> list[list[str]]:
    """Rows of tables of figures: what, measured, asked for, command."""
    lines = (re.findall(r"(?:`[^`]*`|[^|`])+", one) for one in text.splitlines() if one[:2] == "| ")
    return [[cell.strip() for cell in cells] for cells in lines if len(cells) == 4]


def in_full() -> str:
    """The tables of all figures, of what is claimed and of speed."""
    texts = ((ROOT / "tests" / name / "README.md").read_text() for name in ("claims", "benchmarks"))
    return "".join(text.partition("## All figures\n")[2].partition("\n## ")[0] for text in texts)


def test_figures_in_short_are_those_in_full() -> None:
    short = rows(README.partition("\n## Figures\n")[2].partition("\n## ")[0])
    known = set(FIGURE.findall(in_full()))
    assert len(short) > 45
    unknown = {row[0]: set(FIGURE.findall(row[1])) - known for row in short}
    assert {what: figures for what, figures in unknown.items() if figures} == {}


def test_what_was_missed_is_missed_in_short_too() -> None:
    """A row in full that falls short has one in short that says so, known by its figures."""
    short = rows(README.partition("\n## Figures\n")[2].partition("\n## ")[0])
    fallen = [set(FIGURE.findall(row[1])) for row in short if "**" in row[1]]
    full = {row[0]: set(FIGURE.findall(row[1])) for row in rows(in_full()) if "**" in row[1]}
    assert len(full) > 20
    alike = {what: max(len(own & one) for one in fallen) for what, own in full.items()}
    assert {what: count for what, count in alike.items() if count < 2} == {}


def test_every_setting_is_named_with_its_default() -> None:
    missing = [
        name
        for name, default, _ in table(Settings)
        if f"`{name}` | `{default}`" not in SERVICE and f"`{name}` | empty" not in SERVICE
    ]
    assert missing == []


def test_the_two_commands_stand_in_the_readme() -> None:
    assert README.count("python3 -m venv") == 2
    assert "<!-- test command -->" in README
    assert "\nunset PYTHONDONTWRITEBYTECODE && python3" in README, "every start would compile anew"


ROUTE = re.compile(r"`((?:GET|POST|PUT|PATCH|DELETE) /[^`?]*)`")


def test_every_route_is_named_and_no_other(tmp_path: Path) -> None:
    settings = Settings(database_url=f"sqlite:///{tmp_path / 'x.db'}")
    store = make_store(settings)
    prepare(store, settings)
    paths = make_app(store, FakeScience(), settings).openapi()["paths"]
    store.close()
    served = {f"{method.upper()} {path}" for path, methods in paths.items() for method in methods}
    assert set(ROUTE.findall(SERVICE)) == served
    assert set(ROUTE.findall(OTHERS)) <= served


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

    table_rows = re.findall(r"^\| `(bladetwin(?: [a-z]+)+)", SERVICE, re.MULTILINE)
    assert {" ".join(row.split()[:3]) for row in table_rows} == words(commands, "bladetwin")


PROBLEM = re.compile(r"""\b[45]\d\d,\s*["']([a-z]+(?:-[a-z]+)*)["']""")


def kinds(source: str) -> set[str]:
    """The kinds of problems that a module answers with."""
    routed = re.findall(r"kinds = {.*?}|kinds\.get\(.*?\)", source)
    return set(PROBLEM.findall(source)) | set(re.findall(r'"([a-z-]+)"', " ".join(routed)))


def test_every_kind_of_problem_is_named_and_no_other() -> None:
    modules = (ROOT / "service" / "api").rglob("*.py")
    served = set().union(*(kinds(path.read_text()) for path in modules))
    part = SERVICE.partition("| problem `urn:bladetwin:problem:…`")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| (`[^|]*`) \|", part, re.MULTILINE)
    assert {kind for row in rows for kind in re.findall(r"`([a-z-]+)`", row)} == served
    assert kinds('problem(request, 418, "short-and-stout", detail)') == {"short-and-stout"}
