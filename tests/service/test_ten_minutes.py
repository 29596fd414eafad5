"""The README's first ten minutes, run word for word against the service that they start.

Only the port is another one than 8000, which may be somebody else's here; the last part, which asks
for a proxy that ends TLS, is run as far as this machine goes.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import httpx
import pytest

from service.free_port import free_port

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
SERVICE = (ROOT / "service" / "README.md").read_text()

PATIENCE = 12  # times that one waits, where a worker compiles its kernels first


def blocks() -> list[str]:
    part = README.partition("\n## Ten minutes\n")[2].partition("\n## ")[0]
    return re.findall(r"```sh\n(.*?)```", part, re.DOTALL)


def commands(block: str) -> list[str]:
    """The commands of a block; lines that end with a backslash go on."""
    whole = block.replace("\\\n", " ")
    return [line.partition("    # ")[0].strip() for line in whole.splitlines() if line.strip()]


@pytest.fixture
def shell(tmp_path: Path) -> dict[str, str]:
    """An environment in which `bladetwin` is the one under test, and nothing is set."""
    if shutil.which("curl") is None:
        pytest.skip("no curl on this system: apt-get install curl")
    folder = tmp_path / "bin"
    folder.mkdir()
    command = folder / "bladetwin"
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -P -m service.cli "$@"\n')
    command.chmod(0o755)
    plain = {k: v for k, v in os.environ.items() if not k.startswith("BLADETWIN_")}
    return plain | {"PATH": f"{folder}:{os.environ['PATH']}"}


def run(line: str, shell: dict[str, str], folder: Path, port: int) -> str:
    told = line.replace("localhost:8000", f"127.0.0.1:{port}")
    done = subprocess.run(
        ["sh", "-c", told], env=shell, cwd=folder, capture_output=True, text=True, timeout=600,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, (told, done.stderr)
    return done.stdout


def test_the_first_ten_minutes_go_as_they_are_written(
    shell: dict[str, str], tmp_path: Path
) -> None:
    first, last = blocks()
    lines = commands(first)
    assert [line.split()[0] for line in lines] == ["curl"] * 5
    port = free_port()
    begun = time.monotonic()
    with (tmp_path / "log").open("wb") as log:
        server = subprocess.Popen(
            ["bladetwin", "serve", "--port", str(port)],
            env=shell, cwd=tmp_path, stdout=log, stderr=log, start_new_session=True,
        )  # fmt: skip
    try:
        url = f"http://127.0.0.1:{port}"
        while True:
            try:
                if httpx.get(f"{url}/readyz").status_code == 200:
                    break
            except httpx.TransportError:
                pass
            assert server.poll() is None, (tmp_path / "log").read_text()[-2000:]
            assert time.monotonic() - begun < 600, (tmp_path / "log").read_text()[-2000:]
            time.sleep(0.2)
        create, post, wait, predict, limit = lines
        made, posted = (json.loads(run(one, shell, tmp_path, port)) for one in (create, post))
        assert [blade["id"] for blade in made["blades"]] == ["B01", "B02"]
        assert posted == {
            "items": [{"id": "i1", "seq": 1, "status": "accepted"}], "head_seq": 1,
        }  # fmt: skip
        for _ in range(PATIENCE):
            waited = json.loads(run(wait, shell, tmp_path, port))
            if waited["applied_seq"] == 1:
                break
        assert waited["applied_seq"] == 1
        band = json.loads(run(predict, shell, tmp_path, port))
        assert band["time_h"] == [24_000.0, 50_000.0]
        assert 0.1 < band["mean"][0] < band["mean"][1] < 1.0
        assert all(a < b < c for a, b, c in zip(band["lower"], band["mean"], band["upper"],
                                                strict=True))  # fmt: skip
        life = json.loads(run(limit, shell, tmp_path, port))
        hours = [hour for hour in life["quantiles"].values() if hour is not None]
        assert hours == sorted(hours)
        assert 0.0 < life["passed"][-1] < 1.0
        gateway = re.search(r"```sh\n(curl [^`]*sensorthings\+json[^`]*)```", SERVICE)
        assert gateway is not None
        assert json.loads(run(gateway[1], shell, tmp_path, port))["head_seq"] == 3
        glance = re.search(r"In a terminal: `([^`]+)`", README)
        assert glance is not None
        told = run(f"{glance[1]} --url {url}", shell, tmp_path, port)
        assert "B01" in told
        key, serve, _ = commands(last)
        assert serve == "bladetwin serve --host 0.0.0.0"
        secret = re.search(r"btk_\S+", run(key, shell, tmp_path, port))
        assert secret is not None
        asked = {"Authorization": f"Bearer {secret[0]}"}
        answer = httpx.get(
            f"{url}/v1/rotors/r1", headers=asked | {"X-Forwarded-For": "192.0.2.1"}, timeout=60
        )
        assert answer.status_code == 200, answer.text
        bare = httpx.get(
            f"{url}/v1/rotors/r1", headers={"X-Forwarded-For": "192.0.2.1"}, timeout=60
        )
        assert bare.status_code == 401, "negative control: through a proxy it needs the key"
    finally:
        os.killpg(server.pid, signal.SIGTERM)
        server.wait(600)
