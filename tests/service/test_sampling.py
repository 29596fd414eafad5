"""Runs from a model served over UM-Bridge, by the protocol's own package."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from typer.testing import CliRunner

from core.archive import Archive
from core.errors import InputError, ModelError
from service import sampling
from service.cli import app
from service.free_port import free_port
from tests.exchanger import BOTH, NETWORK, TIME_H, drop, network, transfer
from tests.patience import PATIENCE_S
from tests.service.test_processes import ROOT

HOURS = ",".join(f"{t:g}" for t in TIME_H)


@contextmanager
def serving(limit: float, log: Path) -> Iterator[str]:
    """An UM-Bridge server of its own on the loopback."""
    port = free_port()
    url = f"http://127.0.0.1:{port}"
    command = [sys.executable, "-m", "tests.service.served_exchanger", str(port), str(limit)]
    path = f"{ROOT}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"
    with open(log, "w") as out:
        process = subprocess.Popen(
            command, cwd=ROOT, stdout=out, stderr=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": path},
        )  # fmt: skip
        try:
            end = time.monotonic() + PATIENCE_S
            while True:
                assert process.poll() is None
                assert time.monotonic() < end
                try:
                    httpx.get(f"{url}/Info").raise_for_status()
                    break
                except httpx.TransportError:
                    time.sleep(0.05)
            yield url
        finally:
            process.kill()
            process.wait()


def run(*words: str) -> Any:
    return CliRunner().invoke(app, [*words])


def test_a_served_model_is_run_at_maximin_points_and_a_sampling_that_was_cut_goes_on(
    tmp_path: Path,
) -> None:
    (tmp_path / "net.yaml").write_text(BOTH)
    words = ["model", "sample", "--network", str(tmp_path / "net.yaml"), "--times", HOURS]
    words += ["--design", "12", "--out", str(tmp_path / "runs")]
    with serving(7.0, tmp_path / "first") as url:
        done = run(*words, url)
    assert done.exit_code == 1
    asked = (tmp_path / "first").read_text().count("[")
    assert asked == 12, "a failed run does not keep the others from being made"
    there = Archive.open(tmp_path / "runs").done()
    assert 6 <= len(there) < 12
    assert f"{len(there)} of 12 runs" in done.stdout
    with serving(99.0, tmp_path / "second") as url:
        assert run(*words, url).exit_code == 0
        again = run(*words, url)
    assert again.exit_code == 0
    assert (tmp_path / "second").read_text().count("[") == 12 - len(there)
    archive = Archive.open(tmp_path / "runs")
    assert len(archive.done()) == 12
    for k, one in archive.runs():
        x = np.array([one.inputs["roughness"], one.inputs["fouling_rate"]])
        np.testing.assert_allclose(one.values["drop"], drop(x, TIME_H), rtol=1e-12, err_msg=str(k))
        np.testing.assert_allclose(one.values["transfer"], transfer(x, TIME_H), rtol=1e-12)
    trained = run(
        "model", "train", str(tmp_path / "runs"), "--network", str(tmp_path / "net.yaml"),
        "--out", str(tmp_path / "model"), "--json",
    )  # fmt: skip
    assert trained.exit_code == 0, trained.output


def test_a_served_model_that_does_not_fit_is_refused_by_name(tmp_path: Path) -> None:
    with serving(99.0, tmp_path / "log") as url, httpx.Client(base_url=url, timeout=60) as http:
        with pytest.raises(InputError, match="use one of \\['exchanger'\\]"):
            sampling.Served(http, "pump", {})
        served = sampling.Served(http, None, {})
        with pytest.raises(InputError, match="are not the sizes of drop \\(scalar\\)"):
            sampling.sample(served, network(NETWORK), str(tmp_path / "a"), TIME_H.tolist(), 4)
        salt = "  - {name: salt, level: known, prior: {kind: uniform, low: 0, high: 1}}\n"
        more = BOTH.replace("quantities:", f"{salt}quantities:")
        with pytest.raises(InputError, match="are not the 3 parameters"):
            sampling.sample(served, network(more), str(tmp_path / "a"), TIME_H.tolist(), 4)
        assert not (tmp_path / "a").exists()
        doubled = sampling.Served(http, None, {"scale": 2})
        x = np.array([3.0, 1e-4])
        np.testing.assert_allclose(doubled(x)[9:], 2 * served(x)[9:])
    with httpx.Client(base_url=url) as http, pytest.raises(ModelError, match="does not answer"):
        sampling.Served(http, None, {})
