"""`bladetwin export --format …`: the bytes of the API from the database itself."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
from typer.testing import CliRunner

from core.errors import InputError
from core.observation import Inspection
from service.cli import app as commands
from service.settings import Settings
from service.worker.loop import Worker

ROTOR = "/v1/rotors/r1"
FILES = [
    ("csv", "", "/inspections?format=csv"),
    ("csv", "--blade B2", "/inspections?format=csv&blade=B2"),
    ("sensorthings", "", "/inspections?format=sensorthings"),
    ("csv", "--prediction --blade B1 --times 0,8000.5",
     "/blades/B1/prediction?times=0,8000.5&format=csv"),
    ("sensorthings", "--prediction --blade B1 --version 1",
     "/blades/B1/prediction?version=1&format=sensorthings"),
    ("netcdf", "--count 70", "/draws?count=70&format=netcdf"),
    ("netcdf", "--blade B1", "/blades/B1/draws?format=netcdf"),
    ("vtu", "--blade B1 --quantity ceeq --times 8000",
     "/blades/B1/field?quantity=ceeq&time_h=8000&format=vtu"),
    ("pvd", "--blade B1 --times 1,2", "/blades/B1/field?times=1,2&format=pvd"),
    ("pvd", "--quantity ceeq --times 1,2", "/field?quantity=ceeq&times=1,2&format=pvd"),
    ("npz", "--blade B1 --quantity ceeq --times 1,2",
     "/blades/B1/field?quantity=ceeq&times=1,2&format=npz"),
    ("arrow", "--blade B1 --quantity ceeq --times 1,2",
     "/blades/B1/field?quantity=ceeq&times=1,2&format=arrow"),
]  # fmt: skip


@pytest.fixture
def told(
    rotor: str, post: Callable[..., int], reading: Callable[..., Inspection], worker: Worker,
    settings: Settings, monkeypatch: pytest.MonkeyPatch,
) -> str:  # fmt: skip
    """B1 and B2 have readings; commands find the database by its setting."""
    post(rotor, reading("i1"), reading("i2", blade="B2", value=0.2))
    worker.drain()
    monkeypatch.setenv("BLADETWIN_DATABASE_URL", settings.database_url)
    monkeypatch.setenv("BLADETWIN_SCIENCE", "fake")
    return rotor


def run(form: str, options: str, file: Path, *more: str) -> Any:
    given = ["export", "r1", str(file), "--format", form, *options.split(), *more]
    return CliRunner().invoke(commands, given)


def same(one: bytes, other: bytes, form: str) -> bool:
    """HDF5 keeps the moment at which its groups were made: there the length has to do."""
    return len(one) == len(other) if form == "netcdf" else one == other


def test_a_file_has_the_bytes_that_the_service_answers(
    told: str, api: httpx.Client, tmp_path: Path
) -> None:
    for number, (form, options, query) in enumerate(FILES):
        file = tmp_path / f"{number}"
        done = run(form, options, file, "--json")
        assert done.exit_code == 0, (query, done.output, done.exception)
        answer = api.get(ROTOR + query)
        assert answer.status_code == 200, answer.text
        assert same(file.read_bytes(), answer.content, form), query
        facts = json.loads(done.output)
        assert facts == {
            "rotor": "r1", "format": form, "file": str(file), "bytes": file.stat().st_size,
        }  # fmt: skip
    assert len(list(tmp_path.glob(".*part"))) == 0


@pytest.mark.parametrize(
    ("form", "options", "what"),
    [
        ("bundle", "--blade B1", "--blade"),
        ("parquet", "--quantity ceeq", "--quantity"),
        ("csv", "--quantity ceeq", "--quantity"),
        ("csv", "--prediction", "--blade"),
        ("vtu", "", "--blade"),
        ("netcdf", "--prediction --blade B1", "--prediction"),
        ("pvd", "--count 7", "--count"),
        ("vtu", "--blade B1 --times 1,2", "--times"),
        ("npz", "--blade B1 --times 1;2", "--times"),
    ],
)
def test_an_option_without_use_is_refused_and_nothing_is_written(
    told: str, tmp_path: Path, form: str, options: str, what: str
) -> None:
    done = run(form, options, tmp_path / "x")
    assert isinstance(done.exception, InputError), done.output
    assert done.exception.what == what
    assert done.exception.remedy
    assert [one.name for one in tmp_path.iterdir() if "x" in one.name] == []


def test_what_fails_on_the_way_leaves_no_file(
    told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    file = folder / "x.zip"
    file.write_bytes(b"before")
    done = run("pvd", "--blade B1 --times 5,4", file, "--force")
    assert done.exit_code == 1
    assert [one.name for one in folder.iterdir()] == ["x.zip"]
    assert file.read_bytes() == b"before", "a file is replaced by a whole one only"
    assert run("pvd", "--blade B1 --times 4,5", file).exit_code == 1, "not without --force"
    assert run("pvd", "--blade B1 --times 4,5", file, "--force").exit_code == 0
    assert file.read_bytes()[:2] == b"PK"


@pytest.mark.parametrize(
    ("form", "options", "fields"),
    [
        ("npz", "--blade B1 --quantity ceeq --times 1,2", 2),
        ("arrow", "--blade B1 --quantity ceeq --times 1,2,3", 3),
        ("pvd", "--quantity ceeq --times 1,2", 6),
    ],
)
def test_fields_are_counted_while_they_are_computed(
    told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, form: str, options: str, fields: int
) -> None:
    """All instants of a wide model take minutes, and nothing was shown."""
    shown: list[tuple[str, int, list[int]]] = []

    @contextmanager
    def bar(name: str, total: int) -> Iterator[Callable[[int], None]]:
        counts: list[int] = []
        shown.append((name, total, counts))
        yield counts.append

    monkeypatch.setattr("service.commands.files.bar", bar)
    assert run(form, options, tmp_path / "a").exit_code == 0
    assert shown == [("fields", fields, list(range(1, fields + 1)))]
