from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from core.blade import BladeRun, Properties, run_campaign, simulate
from core.errors import InputError, ModelError, RangeError

INSTANTS = np.array([0.0, 5.0, 50.0])


@pytest.fixture(scope="module")
def points(base: dict[str, float]) -> list[dict[str, float]]:
    return [{**base, "t1t_rate": rate} for rate in (0.82, 0.87, 0.92, 0.97)]


def test_a_cut_campaign_resumes_with_the_runs_that_are_missing(
    points: list[dict[str, float]],
) -> None:
    got: dict[int, BladeRun] = {}
    told: list[tuple[int, int]] = []

    def cut(index: int, run: BladeRun) -> None:
        if got:
            raise KeyboardInterrupt
        got[index] = run

    with pytest.raises(KeyboardInterrupt):
        run_campaign(points, cut, mesh="coarse", processes=1, time_h=INSTANTS)
    assert len(got) == 1
    first = set(got)

    result = run_campaign(
        points,
        got.__setitem__,
        mesh="coarse",
        done=first,
        processes=2,
        progress=lambda done, total, left: told.append((done, total)) if left >= 0 else None,
        time_h=INSTANTS,
    )
    assert sorted([*first, *result.completed]) == [0, 1, 2, 3]
    assert told == [(2, 4), (3, 4), (4, 4)]
    for index, point in enumerate(points):
        alone = simulate(point, "coarse", time_h=INSTANTS)
        assert np.array_equal(got[index].displacement, alone.displacement)
        assert got[index].inputs == point


def test_truth_runs_arrive_on_the_nodes_of_the_other_mesh(points: list[dict[str, float]]) -> None:
    got: dict[int, BladeRun] = {}
    run_campaign(
        points[:1],
        got.__setitem__,
        mesh="default",
        onto="coarse",
        processes=1,
        time_h=INSTANTS[:2],
    )
    assert got[0].mesh == "coarse"
    assert got[0].ceeq.shape == (2, 1536)


def test_a_run_that_fails_is_reported_and_the_others_go_on(points: list[dict[str, float]]) -> None:
    got: dict[int, BladeRun] = {}
    result = run_campaign(
        points[:2],
        got.__setitem__,
        mesh="coarse",
        properties=[exploding(), Properties()],
        processes=1,
        time_h=INSTANTS,
    )
    assert [failure.index for failure in result.failures] == [0]
    assert "times the allowed error" in result.failures[0].reason
    assert list(got) == [1]
    with pytest.raises(ModelError, match="all 1 runs failed"):
        run_campaign(
            points[:1],
            got.__setitem__,
            mesh="coarse",
            properties=exploding(),
            processes=1,
            time_h=INSTANTS,
        )


def exploding() -> Properties:
    """A rupture line so low that the first hour ends every part of the blade."""
    p = Properties()
    return replace(p, creep=replace(p.creep, larson_miller_c=45.0, tertiary_exponent=8.0))


def test_a_bad_point_is_refused_before_any_process_starts(points: list[dict[str, float]]) -> None:
    def never(index: int, run: BladeRun) -> None:
        raise AssertionError

    with pytest.raises(RangeError, match=r"t1t_rate = 1\.4"):
        run_campaign([*points, {**points[0], "t1t_rate": 1.4}], never)
    with pytest.raises(InputError, match="choose one of"):
        run_campaign(points, never, onto="hexagons")
    with pytest.raises(InputError, match="does not fit 4 runs"):
        run_campaign(points, never, properties=[Properties()])


def test_a_campaign_with_nothing_left_starts_nothing(points: list[dict[str, float]]) -> None:
    result = run_campaign(points, lambda i, run: None, done={0, 1, 2, 3})
    assert result.completed == result.failures == ()


class Shared:
    """A list of runs of which another campaign finishes one meanwhile."""

    elsewhere = 0

    def __init__(self) -> None:
        self.left = [3, 1]
        self.held_elsewhere = 2

    def take(self) -> int | None:
        return self.left.pop() if self.left else None

    def waiting(self) -> bool:
        self.held_elsewhere -= 1
        self.elsewhere = 1 if self.held_elsewhere <= 0 else 0
        return self.held_elsewhere > 0

    def failed(self, index: int, reason: str) -> None:
        raise AssertionError(reason)


def test_a_shared_campaign_computes_what_it_is_given_and_waits_for_the_others(
    points: list[dict[str, float]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("core.blade.campaign.LOOK_S", 0.01)
    got: dict[int, BladeRun] = {}
    told: list[tuple[int, int]] = []
    todo = Shared()
    result = run_campaign(
        points,
        got.__setitem__,
        mesh="coarse",
        done={0},
        todo=todo,
        processes=1,
        progress=lambda done, total, left: told.append((done, total)),
        time_h=INSTANTS[:2],
    )
    assert result.completed == (1, 3)
    assert {k: run.inputs for k, run in got.items()} == {k: points[k] for k in (1, 3)}
    assert told[-1] == (4, 4)


DASK = """
import sys
import numpy as np
from core.blade import run_campaign
from core.builtin.rotor_blade import blade_digest
from core.errors import BladetwinError

def main():
    points = [{"tbc_thickness": 1.0, "t1t_rate": r, "creep_transient": 0.0, "creep_steady": 0.0}
              for r in (0.82, 0.97)]
    code = blade_digest if sys.argv[2] == "same" else Other()
    try:
        done = run_campaign(points, lambda k, run: print(k, run.elongation[-1].hex()),
                            mesh="coarse", dask=sys.argv[1], code=code, time_h=[0.0, 5.0, 50.0])
    except BladetwinError as error:
        print(error)
    else:
        print(len(done.completed))

class Other:
    def __init__(self):
        import os
        self.home = os.getpid()
    def __call__(self):
        import os
        return "a" * 64 if os.getpid() == self.home else "b" * 64

if __name__ == "__main__":
    main()
"""


def through_dask(tmp_path: Path, address: str, code: str = "same") -> list[str]:
    script = tmp_path / "campaign.py"
    script.write_text(DASK)
    words = [sys.executable, script, address, code]
    done = subprocess.run(words, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.mark.skipif(find_spec("distributed") is None, reason="Dask (extra dask) is not installed")
def test_a_dask_cluster_computes_the_same_runs(
    tmp_path: Path, points: list[dict[str, float]]
) -> None:
    *runs, count = through_dask(tmp_path, "local:2")
    alone = [
        simulate({**points[0], "t1t_rate": rate}, "coarse", time_h=INSTANTS).elongation[-1].hex()
        for rate in (0.82, 0.97)
    ]
    assert sorted(runs) == [f"{k} {value}" for k, value in enumerate(alone)]
    assert count == "2"


@pytest.mark.skipif(find_spec("distributed") is None, reason="Dask (extra dask) is not installed")
def test_a_dask_worker_with_other_code_is_refused(tmp_path: Path) -> None:
    (said,) = through_dask(tmp_path, "local:1", "other")
    assert "has other finite-element code: bbbbbbbbbbbb there, aaaaaaaaaaaa here" in said


def test_an_address_that_is_none_or_answers_nothing_is_refused(
    points: list[dict[str, float]], monkeypatch: pytest.MonkeyPatch
) -> None:
    if find_spec("distributed") is None:
        with pytest.raises(InputError, match="install bladetwin"):
            run_campaign(points, lambda k, run: None, dask="local:2")
        return
    with pytest.raises(InputError, match=r"give tcp://host:port or local:2"):
        run_campaign(points, lambda k, run: None, dask="here")
