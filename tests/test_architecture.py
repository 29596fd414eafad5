"""Imports run one way. A breach names the file, the line and the import."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent

FLOORS: tuple[tuple[str, ...], ...] = (
    ("core.errors", "core.rng", "core.compiled", "core.digest", "core.units", "core.pools"),
    (
        "core.network",
        "core.parameter",
        "core.gain",
        "core.answers",
        "core.quantity",
        "core.prior",
        "core.monomials",
        "core.monomials_compiled",
        "core.response",
        "core.mixture",
        "core.observation",
        "core.ages",
        "core.log",
        "core.columns",
        "core.readings",
        "core.archive",
        "core.course",
        "core.drift",
        "core.family",
        "core.expansion",
    ),
    ("core.blade", "core.design", "core.reduction", "core.smc"),
    ("core.surrogate",),
    ("core.builtin",),
    ("core.model",),
    ("core.discrepancy",),
    ("core.calibration",),
    ("core.curves",),
    ("core.prediction", "core.runs_end"),
    ("core.life", "core.rotor_life", "core.planning", "core.diagnosis", "core.posterior_region"),
    ("core.validation",),
)
"""From the ground up: a module imports its own room and lower floors; within the second floor
freely, as its modules know each other's words (network ← observation)."""

LONGEST = 250
LONGER = {
    "service/client/answers.py": "made from the API's document",
    "core/blade/geometry.py": "another text of `core/blade` disowns the shipped models' runs",
}
FORBIDDEN_IN_CORE = {
    "service", "fastapi", "starlette", "uvicorn", "sqlalchemy", "alembic", "psycopg", "sqlite3",
    "httpx", "typer", "rich", "dotenv",
}  # fmt: skip
RULES: tuple[tuple[str, frozenset[str]], ...] = (
    (
        "core/smc",
        frozenset(
            {"core.blade", "core.calibration", "core.network", "core.prior", "core.surrogate"}
        ),
    ),
    (
        "core/blade",
        frozenset({"core.smc", "core.calibration", "core.network", "core.prior", "core.surrogate"}),
    ),
    ("service/handlers", frozenset({"fastapi", "starlette", "httpx", "uvicorn"})),
    ("service/api", frozenset({"sqlalchemy", "psycopg", "sqlite3"})),
    ("service/client", frozenset({"sqlalchemy", "fastapi", "service.store", "service.bootstrap"})),
)
FOR_TESTS = "service.testing"
"""The service in memory wires all of it; nothing of the service knows it."""


def imports(tree: ast.AST) -> Iterator[tuple[int, str]]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.lineno, node.module
            yield from ((node.lineno, f"{node.module}.{a.name}") for a in node.names)


def within(name: str, room: str) -> bool:
    return name == room or name.startswith(room + ".")


def floor_of(name: str) -> int | None:
    for number, rooms in enumerate(FLOORS):
        if any(within(name, room) for room in rooms):
            return number
    return None


def breaches(path: str, source: str) -> list[str]:
    """What in this file breaks a rule."""
    found = []
    module = path.removesuffix(".py").replace("/", ".").removesuffix(".__init__")
    own = floor_of(module)
    for line, name in imports(ast.parse(source)):
        where = f"{path}:{line} imports {name}"
        top = name.split(".")[0]
        if path.startswith("core/") and top in FORBIDDEN_IN_CORE:
            found.append(f"{where}: core knows no {top}")
        target = floor_of(name) if top == "core" else None
        if own is not None and target is not None and target > own:
            found.append(f"{where}: floor {target} lies above floor {own}")
        if within(name, FOR_TESTS) and not within(module, FOR_TESTS):
            found.append(f"{where}: {FOR_TESTS} is for users' tests")
        for room, banned in RULES:
            if path.startswith(room) and any(within(name, b) for b in banned):
                found.append(f"{where}: not for {room}")
    return found


def sources() -> list[str]:
    return [
        str(p.relative_to(ROOT))
        for room in ("core", "service")
        for p in (ROOT / room).rglob("*.py")
    ]


def test_every_module_of_core_has_a_floor() -> None:
    homeless = [
        path
        for path in sources()
        if path.startswith("core/")
        and path != "core/__init__.py"
        and floor_of(path.removesuffix(".py").replace("/", ".").removesuffix(".__init__")) is None
    ]
    assert homeless == []


def test_no_module_is_longer_than_can_be_read_at_once() -> None:
    lengths = {p: len((ROOT / p).read_text().splitlines()) for p in sources()}
    assert {p for p, n in lengths.items() if n > LONGEST} == set(LONGER)


def test_imports_run_one_way() -> None:
    found = [b for path in sources() for b in breaches(path, (ROOT / path).read_text())]
    assert found == []


@pytest.mark.parametrize(
    ("path", "source"),
    [
        ("core/smc/moves.py", "from core.network import Network"),
        ("core/blade/run.py", "import core.calibration.online"),
        ("core/response.py", "import sqlalchemy"),
        ("core/observation.py", "from core import prediction"),
        ("service/api/models.py", "from sqlalchemy import select"),
        ("service/client/frames.py", "from service.bootstrap import make_app"),
        ("service/demo/run.py", "from service.testing import in_memory"),
    ],
)
def test_a_breach_is_seen(path: str, source: str) -> None:
    """Negative control: each kind of forbidden import is reported."""
    assert breaches(path, source)
