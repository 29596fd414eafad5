"""Settings: from the environment, checked, handed on, and shown by the help."""

from __future__ import annotations

import io
import json
import logging
import os
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

import service
from core.errors import InputError
from service.cli import app, main
from service.environment import names
from service.settings import Settings
from service.telemetry import JsonLines
from service.worker.supervise import same_code


def test_a_setting_comes_from_the_environment_and_an_argument_overrides_it() -> None:
    environ = {"BLADETWIN_PORT": "8123", "BLADETWIN_LEASE_S": "2.5", "HOME": "/"}
    settings = Settings.load(environ, port=9001, host=None)
    assert (settings.port, settings.lease_s, settings.host) == (9001, 2.5, "127.0.0.1")


@pytest.mark.parametrize(
    ("name", "value"),
    [("BLADETWIN_PROT", "1"), ("BLADETWIN_PORT", "http"), ("BLADETWIN_LEASE_S", "0")],
)
def test_a_setting_that_does_not_fit_is_refused_by_name(name: str, value: str) -> None:
    with pytest.raises(InputError, match=name):
        Settings.load({name: value})


def test_a_child_process_gets_the_same_settings() -> None:
    settings = Settings(database_url="postgresql://u:secret@h/d", workers=3, cache_mb=1.5)
    assert Settings.load(settings.environ()) == settings


def test_kernels_are_compiled_on_demand() -> None:
    done = CliRunner().invoke(app, ["compile", "--json"])
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["seconds"] > 0


def test_the_help_of_serve_lists_every_setting() -> None:
    shown = CliRunner().invoke(app, ["serve", "--help"]).output
    assert [name for name in names(Settings) if name not in shown] == []
    assert len(names(Settings)) == 46


def test_no_password_is_shown() -> None:
    assert "secret" not in repr(Settings(database_url="postgresql://u:secret@h/d"))


def test_a_database_url_from_a_file_is_handed_on_as_the_file_alone(tmp_path: Path) -> None:
    file = tmp_path / "database_url"
    file.write_text("postgresql://u:hidden@h/d\n")
    settings = Settings.load({"BLADETWIN_DATABASE_URL_FILE": str(file)})
    assert settings.database_url == "postgresql://u:hidden@h/d"
    assert "hidden" not in repr(settings) + str(settings.environ())
    assert Settings.load(settings.environ()) == settings


@pytest.mark.parametrize("content", [None, b"", b"one\ntwo", b"\xff\xfe"])
def test_a_secret_file_that_cannot_be_used_is_named(tmp_path: Path, content: bytes | None) -> None:
    file = tmp_path / "secret"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(InputError, match="BLADETWIN_DATABASE_URL_FILE"):
        Settings.load({"BLADETWIN_DATABASE_URL_FILE": str(file)})


def test_a_url_given_twice_is_refused_without_showing_it(tmp_path: Path) -> None:
    file = tmp_path / "database_url"
    file.write_text("postgresql://u:hidden@h/d")
    environ = {"BLADETWIN_DATABASE_URL": "postgresql://u:hidden@h/e"}
    with pytest.raises(InputError, match="both given") as refused:
        Settings.load(environ | {"BLADETWIN_DATABASE_URL_FILE": str(file)})
    assert "hidden" not in str(refused.value)


def test_a_log_line_is_one_json_object() -> None:
    out = io.StringIO()
    handler = logging.StreamHandler(out)
    handler.setFormatter(JsonLines())
    logger = logging.Logger("bladetwin.test")
    logger.addHandler(handler)
    logger.warning("two\nlines of %s", "rotor r1")
    line = json.loads(out.getvalue())
    assert (line["level"], line["message"]) == ("warning", "two\nlines of rotor r1")
    assert out.getvalue().count("\n") == 1


def test_every_command_has_help_and_a_wrong_setting_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    runner = CliRunner()
    for command in (
        ["serve"],
        ["worker"],
        ["migrate"],
        ["demo"],
        ["model", "build"],
        ["audit"],
        ["keys", "list"],
    ):
        shown = runner.invoke(app, [*command, "--help"])
        assert shown.exit_code == 0
        assert "--help" in shown.output
    monkeypatch.setenv("BLADETWIN_PROT", "1")
    monkeypatch.setattr("sys.argv", ["bladetwin", "migrate"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 1
    told = capsys.readouterr().err
    assert told.startswith("bladetwin: BLADETWIN_PROT")
    assert told.count("\n") == 1


def test_a_child_runs_the_code_of_its_parent_wherever_it_starts(tmp_path: Path) -> None:
    """A folder that holds another `service` does not come first; without the path it would."""
    (tmp_path / "service").mkdir()
    (tmp_path / "service" / "__init__.py").write_text("raise SystemExit('another copy')\n")

    def told(flags: list[str], environ: dict[str, str]) -> str:
        command = [sys.executable, *flags, "-c", "import service; print(service.__file__)"]
        done = subprocess.run(
            command, cwd=tmp_path, env=environ, capture_output=True, text=True, check=False
        )
        return done.stdout.strip() or done.stderr.strip()

    assert told(["-P"], same_code(dict(os.environ))) == service.__file__
    assert told([], dict(os.environ)) == "another copy", "negative control"


def test_commands_have_linear_algebra_on_one_thread_unless_told_otherwise() -> None:
    """Last bits, and so digests and random streams, must not depend on the processors."""
    seen = (
        "import service.cli, core.calibration.online, threadpoolctl as t; "
        "print({i['num_threads'] for i in t.threadpool_info() if i['user_api'] == 'blas'})"
    )
    clean = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}
    most = min(2, os.cpu_count() or 1)
    for given, found in (({}, "{1}"), ({"OPENBLAS_NUM_THREADS": "2"}, f"{{{most}}}")):
        environ = same_code({**clean, **given})
        run = subprocess.run(
            [sys.executable, "-c", seen], env=environ, capture_output=True, text=True, check=True
        )
        assert run.stdout.strip() == found


LOADED = """
import sys
import service.cli, service.bootstrap
from service.bootstrap import Later

made = []
science = Later(lambda: made.append(1) or "science")
assert not made
assert science.upper() == science.upper() == "SCIENCE"
assert made == [1]
print(*sorted({name.partition(".")[0] for name in sys.modules}))
"""


def test_a_worker_loads_neither_the_api_nor_a_science_before_it_is_asked() -> None:
    done = subprocess.run(
        [sys.executable, "-P", "-c", LOADED], capture_output=True, text=True, check=True
    )
    loaded = set(done.stdout.split())
    assert {"sqlalchemy", "typer"} <= loaded
    assert not {"fastapi", "uvicorn", "httpx", "rich", "psycopg", "numba", "sklearn"} & loaded


PHYSICS = """
import sys
import service.bootstrap, service.science, core.calibration.online
from core.model import rotor_blade

rotor_blade().surrogate
print(*sorted({name.partition(".")[0] for name in sys.modules}))
"""
NEVER = {"sklearn", "pandas", "xarray", "h5netcdf", "h5py", "meshio", "matplotlib", "rich"}


def test_a_model_that_was_built_is_loaded_without_what_built_it() -> None:
    """Half a second of every start: a worker that died is back so much sooner."""
    done = subprocess.run(
        [sys.executable, "-P", "-c", PHYSICS], capture_output=True, text=True, check=True
    )
    loaded = set(done.stdout.split())
    assert {"numba", "scipy"} <= loaded
    assert not NEVER & loaded
