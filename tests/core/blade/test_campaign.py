from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest

from core.blade import BladeRun, Properties, run_campaign, simulate
from core.blade.integrate import Tolerance
from core.errors import InputError, ModelError, RangeError

INSTANTS = np.array([0.0, 5.0, 50.0])
LOOSE = Tolerance(relative=1e-2, absolute=5e-6)  # runs are compared with the same runs


@pytest.fixture(scope="module")
def points(base: dict[str, float]) -> list[dict[str, float]]:
    return [{**base, "t1t_rate": rate} for rate in (0.82, 0.87, 0.92, 0.97)]


@pytest.fixture(scope="module")
def alone(points: list[dict[str, float]]) -> list[BladeRun]:
    """Each of them without a campaign."""
    return [simulate(one, "coarse", time_h=INSTANTS, tolerance=LOOSE) for one in points]


def test_a_cut_campaign_resumes_with_the_runs_that_are_missing(
    points: list[dict[str, float]], alone: list[BladeRun]
) -> None:
    got: dict[int, BladeRun] = {}
    told: list[tuple[int, int]] = []
    options = {"mesh": "coarse", "time_h": INSTANTS, "tolerance": LOOSE}

    def cut(index: int, run: BladeRun) -> None:
        if got:
            raise KeyboardInterrupt
        got[index] = run

    with pytest.raises(KeyboardInterrupt):
        run_campaign(points, cut, processes=1, **options)
    assert len(got) == 1
    first = set(got)

    result = run_campaign(
        points,
        got.__setitem__,
        done=first,
        processes=2,
        progress=lambda done, total, left: told.append((done, total)) if left >= 0 else None,
        **options,
    )
    assert sorted([*first, *result.completed]) == [0, 1, 2, 3]
    assert told == [(2, 4), (3, 4), (4, 4)]
    for index, point in enumerate(points):
        assert np.array_equal(got[index].displacement, alone[index].displacement)
        assert got[index].inputs == point


def test_truth_runs_arrive_on_the_nodes_of_the_other_mesh(
    points: list[dict[str, float]], alone: list[BladeRun]
) -> None:
    got: dict[int, BladeRun] = {}
    run_campaign(
        points[:1],
        got.__setitem__,
        mesh="coarse",
        onto="default",
        processes=1,
        time_h=INSTANTS,
        tolerance=LOOSE,
    )
    assert got[0].mesh == "default"
    assert got[0].ceeq.shape == (3, 5600)
    assert np.array_equal(got[0].elongation, alone[0].elongation), "computed on its own mesh"


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
        tolerance=LOOSE,
    )
    assert result.completed == (1, 3)
    assert {k: run.inputs for k, run in got.items()} == {k: points[k] for k in (1, 3)}
    assert told[-1] == (4, 4)


DASK = """
def main():
    from core.blade import run_campaign
    from core.blade.integrate import Tolerance
    from core.builtin.rotor_blade import blade_digest
    from core.errors import BladetwinError

    points = [{"tbc_thickness": 1.0, "t1t_rate": r, "creep_transient": 0.0, "creep_steady": 0.0}
              for r in (0.82, 0.97)]
    options = {"time_h": [0.0, 5.0, 50.0], "tolerance": Tolerance(relative=1e-2, absolute=5e-6)}
    for address, code in (("local:2", blade_digest), ("local:1", Other())):
        try:
            done = run_campaign(points, lambda k, run: print(k, run.elongation[-1].hex()),
                                mesh="coarse", dask=address, code=code, **options)
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


@pytest.fixture(scope="module")
def through_dask(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """What a campaign says, and then one whose worker has other code."""
    script = tmp_path_factory.mktemp("dask") / "campaign.py"
    script.write_text(DASK)
    words = [sys.executable, script]
    done = subprocess.run(words, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.mark.skipif(find_spec("distributed") is None, reason="Dask (extra dask) is not installed")
def test_a_dask_cluster_computes_the_same_runs(
    through_dask: list[str], alone: list[BladeRun]
) -> None:
    *runs, count, _ = through_dask
    known = [alone[0].elongation[-1].hex(), alone[3].elongation[-1].hex()]
    assert sorted(runs) == [f"{k} {value}" for k, value in enumerate(known)]
    assert count == "2"


@pytest.mark.skipif(find_spec("distributed") is None, reason="Dask (extra dask) is not installed")
def test_a_dask_worker_with_other_code_is_refused(through_dask: list[str]) -> None:
    said = through_dask[-1]
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
