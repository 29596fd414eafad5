"""The image: its rules hold, and its commands do what they say.

No container is built here. Instead every instruction of the Dockerfile is carried out in a folder
that stands for the image's root: COPY from what .dockerignore lets through, RUN by a shell, and
then ENTRYPOINT, CMD, HEALTHCHECK and compose's commands against a real PostgreSQL.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest
import yaml
from sqlalchemy import create_engine, make_url, text

from service.client import Client, read_webhook
from service.free_port import free_port
from tests.docker.dockerfile import FILE, ROOT, faults, ignored, stages, visible
from tests.service.receiver import receiving

TEXT = FILE.read_text()
COMPOSE = yaml.safe_load((ROOT / "docker" / "compose.yaml").read_text())
PATIENCE_S = 180.0
LONG_S = 1800.0  # installing and compiling, on a machine that others keep busy


@pytest.fixture(autouse=True, scope="module")
def a_python(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """What the base image has, and a machine with python3 alone has not: a `python`."""
    folder = tmp_path_factory.mktemp("base")
    (folder / "python").symlink_to(Path(sys.executable).resolve())
    with pytest.MonkeyPatch.context() as patch:
        if shutil.which("python") is None:
            patch.setenv("PATH", f"{os.environ['PATH']}{os.pathsep}{folder}")
        yield


def hadolint(source: str) -> subprocess.CompletedProcess[str]:
    own = Path(sys.executable).parent  # not on the PATH where the environment is not activated
    found = shutil.which("hadolint", path=f"{own}{os.pathsep}{os.environ['PATH']}")
    assert found is not None, "there is no hadolint: install requirements-dev.lock"
    return subprocess.run(
        [found, "--no-color", "--failure-threshold", "style", "-"],
        input=source,
        capture_output=True,
        text=True,
    )


def test_a_linter_finds_nothing_in_the_dockerfile() -> None:
    done = hadolint(TEXT)
    assert (done.returncode, done.stdout) == (0, "")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("FROM python:3.11-slim-bookworm AS build", "FROM python AS build"),
        ("WORKDIR /src", "WORKDIR src"),
        ('CMD ["serve"]', 'CMD ["serve"]\nCMD ["worker"]'),
        ("COPY --from=build", "COPY --from=built"),
    ],
)
def test_the_linter_would_notice(old: str, new: str) -> None:
    assert old in TEXT
    assert hadolint(TEXT.replace(old, new)).returncode != 0


def test_the_dockerfile_keeps_our_rules() -> None:
    assert faults(TEXT) == []


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("USER 10001:10001", "USER root", "not a number"),
        ("USER 10001:10001\n", "", "not a number"),
        ("USER 10001:10001", "USER 0:10001", "not a number"),
        ('ENTRYPOINT ["bladetwin"]', "ENTRYPOINT bladetwin", "no exec form"),
        ('CMD ["serve"]', "CMD serve", "no exec form"),
        ('CMD ["bladetwin", "health"]', 'CMD ["curl", "-f", "localhost"]', "need not have"),
        (" --require-hashes", "", "without hashes"),
        ("COPY --from=build", "RUN apt-get install -y gcc\nCOPY --from=build", "installs things"),
        ("BLADETWIN_HOST", "BLADETWIN_DATABASE_URL=postgresql://u:p@h/d BLADETWIN_HOST", "secret"),
        ("3.11-slim-bookworm\n", "latest\n", "every day"),
    ],
)
def test_each_rule_would_be_missed(old: str, new: str, told: str) -> None:
    assert old in TEXT
    assert any(told in one for one in faults(TEXT.replace(old, new)))


@pytest.mark.parametrize(
    ("path", "seen"),
    [
        ("core/smc/particles.py", True),
        ("service/cli.py", True),
        ("requirements.lock", True),
        ("service/__pycache__/cli.cpython-311.pyc", False),
        (".git/config", False),
        ("docker/secrets/database_url", False),
        ("bladetwin.db", False),
        ("tests/conftest.py", False),
    ],
)
def test_a_build_sees_the_packages_and_no_secret(path: str, seen: bool) -> None:
    assert visible(path, ignored()) is seen


@dataclass(frozen=True, slots=True)
class Image:
    """A folder that stands for the image's root."""

    root: Path

    def here(self, text: str) -> str:
        """The same text with the image's folders below this root."""
        return re.sub(r"(?<![\w/.\-])/(opt|src|var)(?=[/\s\"':]|$)", rf"{self.root}/\1", text)

    def environ(self, **given: str) -> dict[str, str]:
        """The image's environment, and nothing of ours that could change what is run."""
        kept = ("PATH", "PIP_", "LANG", "TMPDIR", "SSL_", "REQUESTS_")
        environ = {name: value for name, value in os.environ.items() if name.startswith(kept)}
        for name, value in stages(TEXT)[-1].environ().items():
            environ[name] = self.here(value).replace("$PATH", environ["PATH"])
        return (
            environ | {"HOME": str(self.root / "var/lib/bladetwin"), "OMP_NUM_THREADS": "1"} | given
        )

    def command(self, *words: str) -> list[str]:
        """ENTRYPOINT with these words after it, as compose's `command` replaces CMD."""
        first, *rest = stages(TEXT)[-1].argv("ENTRYPOINT")
        return [str(self.root / "opt/bladetwin/bin" / first), *rest, *words]

    def run(self, *words: str, **given: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            self.command(*words),
            env=self.environ(**given),
            cwd=self.root / "var/lib/bladetwin",
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
        )

    def code(self) -> dict[str, tuple[int, int]]:
        """Every file of the installed code, with its size and time."""
        files = [p for p in (self.root / "opt").rglob("*") if p.is_file()]
        return {str(p): (p.stat().st_size, p.stat().st_mtime_ns) for p in files}


def build(root: Path) -> Image:
    """Carry out the Dockerfile below `root`. An instruction that fails raises."""
    image = Image(root)
    for stage in stages(TEXT):
        folder = root
        for word, rest in stage.steps:
            if word == "WORKDIR":
                folder = Path(image.here(rest))
                folder.mkdir(parents=True, exist_ok=True)
            elif word == "COPY" and "--from=" not in rest:
                copy(rest, folder)
            elif word == "RUN" and stage.name:
                shell(image, rest, folder)
            elif word == "RUN":
                for part in rest.split("&&"):
                    as_user(image, shlex.split(part))
    return image


def shell(image: Image, line: str, folder: Path) -> None:
    environ = {n: v for n, v in image.environ().items() if n != "PYTHONDONTWRITEBYTECODE"}
    environ.setdefault("PIP_CACHE_DIR", str(Path.home() / ".cache" / "pip"))  # the cache mount
    environ.setdefault("PIP_NO_COMPILE", "1")  # `imported` does it for what is used
    done = subprocess.run(
        ["/bin/sh", "-ec", image.here(line)],
        cwd=folder,
        env=environ,
        capture_output=True,
        text=True,
        timeout=LONG_S,
    )
    assert done.returncode == 0, f"RUN {line}\n{done.stdout[-1000:]}{done.stderr[-3000:]}"


def imported(image: Image) -> None:
    """Import all of our code once, which leaves the bytecode that pip would have: commands do not
    write it, and each would compile all that it imports.
    """
    program = (
        "import contextlib, importlib, pkgutil, core, service",
        "for one in (core, service):",
        "    for module in pkgutil.walk_packages(one.__path__, f'{one.__name__}.'):",
        "        with contextlib.suppress(Exception):  # of an extra that is not there",
        "            importlib.import_module(module.name)",
    )
    words = ["/opt/bladetwin/bin/python", "-c", "\n".join(program)]
    shell(image, shlex.join(words), image.root)


def copy(rest: str, folder: Path) -> None:
    """COPY of what .dockerignore lets through; as in a build, a source that is not there fails."""
    *sources, target = rest.split()
    tracked = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard", "-z", "--", *sources],
        cwd=ROOT,
        capture_output=True,
        check=True,
    ).stdout.decode()
    patterns = ignored()
    for source in sources:
        found = [
            one
            for one in tracked.split("\0")
            if (one == source or one.startswith(f"{source}/")) and visible(one, patterns)
        ]
        assert found, f"COPY {rest}: {source} is not there for a build"
        for one in found:
            inside = one.removeprefix(source).lstrip("/")
            into = folder / target / (inside or Path(one).name)
            into.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / one, into)


def as_user(image: Image, words: list[str]) -> None:
    """A step of the last stage. Users are not made on this machine: their options are looked up."""
    if words[0] in ("groupadd", "useradd"):
        told = subprocess.run([words[0], "--help"], capture_output=True, text=True).stdout
        unknown = [
            w
            for w in words
            if w.startswith("--") and f"{w.partition('=')[0]} " not in told.replace(",", " ")
        ]
        assert unknown == [], f"{words[0]} has no {unknown}"
        return
    own = {"--owner=10001": f"--owner={os.geteuid()}", "--group=10001": f"--group={os.getegid()}"}
    done = subprocess.run(
        [image.here(own.get(w, w)) for w in words], capture_output=True, text=True
    )
    assert done.returncode == 0, f"{words}: {done.stderr}"


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> Image:
    made = build(tmp_path_factory.mktemp("image"))
    imported(made)
    return made


@pytest.fixture(scope="module")
def secrets(tmp_path_factory: pytest.TempPathFactory, postgres_server: str) -> Iterator[Path]:
    """docker/secrets as docker/secrets.sh makes it, with the URL of a database of our own."""
    folder = tmp_path_factory.mktemp("run") / "secrets"
    subprocess.run([ROOT / "docker" / "secrets.sh", folder], check=True)
    name = f"bladetwin_image_{os.getpid()}"
    admin = create_engine(postgres_server, isolation_level="AUTOCOMMIT")
    with admin.connect() as connection:
        connection.execute(text(f"CREATE DATABASE {name}"))
    url = make_url(postgres_server).set(database=name, drivername="postgresql")
    file = folder / "database_url"
    file.chmod(0o600)
    file.write_text(url.render_as_string(hide_password=False) + "\n")
    yield folder
    with admin.connect() as connection:
        connection.execute(text(f"DROP DATABASE {name} WITH (FORCE)"))
    admin.dispose()


def given(service: str, secrets: Path, **more: str) -> dict[str, str]:
    """The environment of a service of compose, with its secrets where they are here; the address
    is the loopback's, and the science the exact twin."""
    told = {name: str(value) for name, value in COMPOSE["services"][service]["environment"].items()}
    told = {name: value.replace("/run/secrets", str(secrets)) for name, value in told.items()}
    return told | {"BLADETWIN_HOST": "127.0.0.1", "BLADETWIN_SCIENCE": "fake"} | more


@contextmanager
def started(image: Image, service: str, environ: dict[str, str]) -> Iterator[subprocess.Popen[str]]:
    """The command of a service of compose; it has to end with 0 when it is told to."""
    process = subprocess.Popen(
        image.command(*COMPOSE["services"][service]["command"]),
        env=image.environ(**environ),
        cwd=image.root / "var/lib/bladetwin",
        text=True,
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
    )
    try:
        yield process
        assert process.poll() is None, f"{service} ended: {process.stderr.read()[-2000:]}"  # type: ignore[union-attr]
        process.terminate()
        assert process.wait(PATIENCE_S) == 0, f"{service} did not end cleanly on SIGTERM"
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()
        if process.stderr is not None:
            process.stderr.close()


def until(what: str, true: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE_S
    while not true():
        assert time.monotonic() < end, f"{what} did not come"
        time.sleep(0.2)


def test_the_image_has_neither_installer_nor_builder(image: Image) -> None:
    programs = {path.name for path in (image.root / "opt/bladetwin/bin").iterdir()}
    assert "bladetwin" in programs
    assert not {"pip", "pip3", "hatchling"} & programs


def test_the_whole_of_compose_runs_from_the_image_and_writes_nothing_beside_its_code(
    image: Image, secrets: Path
) -> None:
    before = image.code()
    port = str(free_port())
    near = {"BLADETWIN_WEBHOOK_NETWORKS": "127.0.0.0/8, ::1"}
    environ = given("api", secrets, BLADETWIN_PORT=port, BLADETWIN_KEYS="always", **near)
    health = stages(TEXT)[-1].argv("HEALTHCHECK")[1:]
    assert image.run(*health, **environ).returncode == 1, "nothing runs yet"
    done = image.run("serve", "--workers", "0", **environ)
    assert done.returncode == 1
    assert "bladetwin migrate" in done.stderr
    done = image.run(*COMPOSE["services"]["migrate"]["command"], **given("migrate", secrets))
    assert done.returncode == 0, done.stderr
    made = image.run(
        *["keys", "create", "prometheus", "--scope", "read", "--scope", "ingest"],
        *["--scope", "operate", "--json"],
        **given("migrate", secrets),
    )
    token = json.loads(made.stdout)["key"]
    with_key = {"Authorization": f"Bearer {token}"}
    http = httpx.Client(base_url=f"http://127.0.0.1:{port}", headers=with_key, timeout=60.0)
    with started(image, "api", environ), Client(http=http) as client:
        client.ready(PATIENCE_S)
        healthy = image.run(*health, **environ)
        assert (healthy.returncode, healthy.stderr) == (0, "")
        with (
            started(image, "apply", given("apply", secrets)),
            started(image, "seal", given("seal", secrets)),
            started(image, "diagnose", given("diagnose", secrets)),
            started(image, "deliver", given("deliver", secrets, **near)),
            receiving() as receiver,
        ):
            secret = client.create_webhook("ops", receiver.url)["secret"]
            client.create_rotor("r1", blades=["B1"])
            reading = {
                "id": "a",
                "blade": "B1",
                "quantity": "elongation",
                "time_h": 8e3,
                "value": 0.11,
            }
            client.wait_for("r1", client.post_inspections("r1", [reading]), PATIENCE_S)
            client.wait_sealed("r1", PATIENCE_S)
            until("a webhook", lambda: bool(receiver.got))
            got = receiver.got[0]
            assert read_webhook(secret, got.headers, got.body, tolerance_s=900.0)
            found = client.diagnose("r1")["id"]
            until("the diagnosis", lambda: client.diagnosis("r1", found)["status"] == "done")
        assert "bladetwin_rotors 1" in http.get("/metrics").text
    assert image.code() == before, "the code's folder was written to: it cannot be read-only"


def test_the_kernels_are_compiled_into_the_volume(image: Image) -> None:
    """Where machine code goes is seen by the first of it (its index comes before it); that all
    compiles is test_kernels'.
    """
    before, volume = image.code(), image.root / "var/cache/bladetwin"
    process = subprocess.Popen(
        image.command(*COMPOSE["services"]["compile"]["command"]),
        env=image.environ(NUMBA_OPT="0"),  # it need not be fast
        cwd=image.root / "var/lib/bladetwin",
        text=True,
        stderr=subprocess.PIPE,
    )
    try:
        until("machine code", lambda: bool([*volume.rglob("*.nbc")]) or process.poll() is not None)
    finally:
        process.kill()
        _, told = process.communicate()
    assert [*volume.rglob("*.nbc")], told
    assert image.code() == before


@pytest.mark.parametrize(
    "words", [["serve", "--wrokers", "0"], ["worker", "--role", "aply"], ["migrate", "--now"]]
)
def test_a_wrong_word_in_a_command_would_be_noticed(image: Image, words: list[str]) -> None:
    assert image.run(*words).returncode == 2


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("python -m venv", "python -m venv --with-pips"),
        ("--require-hashes", "--requires-hashes"),
    ],
)
def test_a_wrong_word_in_a_run_line_would_be_noticed(tmp_path: Path, old: str, new: str) -> None:
    line = next(run for run in stages(TEXT)[0].all("RUN") if old in run)
    fresh = Image(tmp_path)
    pip = tmp_path / "opt/bladetwin/bin/pip"
    pip.parent.mkdir(parents=True)
    pip.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m pip "$@"\n')
    pip.chmod(0o755)
    with pytest.raises(
        AssertionError, match=f"RUN(?s:.*)(unrecognized|no such option).*{new.split()[-1]}"
    ):
        shell(fresh, line.replace(old, new), tmp_path)


def test_a_source_that_the_build_cannot_see_would_be_noticed(tmp_path: Path) -> None:
    with pytest.raises(AssertionError, match="not there for a build"):
        copy("tests ./", tmp_path)
