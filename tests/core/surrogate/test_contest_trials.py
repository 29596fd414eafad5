"""The long contest: one space of features, equal tuning, trials that are kept."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from core.archive import Archive
from core.errors import InputError, ModelError
from core.rng import stream
from core.surrogate.contest import boosters, run, table, trial
from core.surrogate.contest.features import SETS, Features, targets
from core.surrogate.contest.kept import Kept, keep
from core.surrogate.contest.regressors import Contestant, Effort, Fitted, Setting
from core.surrogate.contest.score import Errors

Array = NDArray[np.float64]
PLAN = replace(trial.QUICK, trees=8, rounds=8, features=12, nodes=25, timed=50)
SHORT = replace(PLAN, folds=2)


@pytest.fixture(scope="module")
def kept(archive: Archive) -> Kept:
    return keep(archive, range(100), nodes=25, seed=3)


def own() -> list[Contestant]:
    """The four that need no extra."""
    return [one for one in boosters.SEVEN if one.package is None]


def test_kept_are_a_sample_of_the_nodes_and_every_runs_worst_one(
    archive: Archive, kept: Kept
) -> None:
    ceeq = archive.stack("ceeq", range(100))[:, -1]
    assert kept.sampled == 25
    assert len(set(kept.nodes.tolist())) == len(kept.nodes) > 25
    assert kept.nodes[kept.worst].tolist() == ceeq.argmax(axis=1).tolist()
    assert kept.stack("displacement", [71, 4]) == pytest.approx(
        archive.stack("displacement", [71, 4])[:, :, kept.nodes]
    )


def test_an_archive_without_a_field_that_is_needed_and_a_missing_run_are_named(
    archive: Archive,
) -> None:
    fewer = tuple(q for q in archive.declaration.quantities if q.name != "ceeq")
    bare = replace(archive, declaration=replace(archive.declaration, quantities=fewer))
    with pytest.raises(ModelError, match="has no ceeq"):
        keep(bare, range(4), nodes=5, seed=1)
    with pytest.raises(InputError, match=r"\[100, 101\] are not in archive"):
        keep(archive, range(102), nodes=5, seed=1)


@pytest.mark.parametrize("which", SETS)
def test_all_features_give_back_every_field_of_the_runs_they_were_made_of(
    kept: Kept, which: str
) -> None:
    parts, runs = targets(kept, which), np.arange(66)
    made, f = Features.of(parts, runs, 99, 1)
    few, g = Features.of(parts, runs, 6, 1)
    assert f.shape[1] > 20
    assert made.encode(parts, runs) == pytest.approx(f, abs=1e-4)
    tip, ceeq, moved = kept.truth(runs)
    whole, cut = made.physical(f, kept.instants), few.physical(g, kept.instants)
    late = kept.instants >= 1000.0
    assert whole[0][:, late] == pytest.approx(tip[:, late], rel=2e-3)
    own, worst = np.arange(66), kept.worst[runs]
    assert whole[1][own, -1, worst] == pytest.approx(ceeq[own, -1, worst], rel=2e-2)
    lost = [float(np.sqrt(np.mean((one[2] - moved) ** 2))) for one in (whole, cut)]
    assert lost[0] < 3e-4
    assert lost[1] > 3 * lost[0]
    assert few.held < made.held == pytest.approx(1.0)


def test_bases_of_a_fold_know_nothing_of_the_runs_left_out(kept: Kept) -> None:
    (fit, left), *_ = trial.folds(66, 3, seed=7)
    parts = targets(kept, "raw")
    spoilt = {
        name: replace(one, values=np.where(np.isin(np.arange(100), left)[:, None, None], 7.0,
                                           one.values))
        for name, one in parts.items()
    }  # fmt: skip
    first, f = Features.of(parts, fit, 12, 1)
    again, g = Features.of(spoilt, fit, 12, 1)
    assert np.array_equal(f, g)
    assert not np.allclose(first.encode(parts, left), again.encode(spoilt, left))


def test_the_tip_is_put_together_from_features_alone(kept: Kept) -> None:
    for which in SETS:
        made, f = Features.of(targets(kept, which), np.arange(66), 40, 1)
        forms = made.tip_forms()
        a, b = forms["elongation"]
        tip = a + f @ b
        if "mean_ceeq" in forms:
            log_a, log_b = forms["mean_ceeq"]
            tip = tip * np.exp(log_a + f @ log_b) * kept.instants[-1]
        assert tip == pytest.approx(made.physical(f, kept.instants)[0][:, -1])


@pytest.mark.parametrize("one", boosters.SEVEN, ids=lambda one: one.name)
def test_every_contestant_has_six_configurations_and_each_of_them_learns(one: Contestant) -> None:
    if not boosters.installed(one):
        pytest.skip(f"{one.package} is not installed")
    assert len({str(s) for s in one.settings}) == 6
    z = stream(5, "contest").uniform(-1, 1, (60, 3))
    y = np.column_stack([3 + z @ [1.0, 0.5, 0.0], z[:, 0] * z[:, 1], z[:, 2] ** 2])
    for setting in one.settings:
        made = one.fit(z, y, setting, Effort(30, 60, 1))
        again = one.fit(z, y, setting, Effort(30, 60, 1))
        off = made.predict(z) - y
        assert np.mean(off**2) < 0.5 * np.mean((y - y.mean(axis=0)) ** 2)
        assert np.array_equal(made.predict(z[:7]), again.predict(z[:7]))


def test_the_configuration_of_the_least_inner_error_is_chosen() -> None:
    def shifted(z: Array, y: Array, setting: Setting, effort: Effort) -> Fitted:
        return Fitted(lambda new: new[:, :1] + setting["by"], None)

    settings = tuple({"by": by} for by in (0.3, 0.02, -0.1))
    one = Contestant("shifted", settings, shifted)
    z = stream(6, "contest").uniform(-1, 1, (30, 2))
    f = z[:, :1]

    def judge(parts: trial.Predicted) -> float:
        return sum(float(np.sum((told - f[left]) ** 2)) for left, told in parts)

    assert trial.tuned(one, z, f, judge, PLAN, 1) == ({"by": 0.02}, 2)
    more = replace(PLAN, configurations=1)
    assert trial.tuned(one, z, f, judge, more, 1) == ({"by": 0.3}, 1)
    none = replace(one, carries=lambda n, d, setting: n > 20)
    with pytest.raises(InputError, match="carry no configuration of shifted"):
        trial.tuned(none, z, f, judge, PLAN, 1)


def test_measures_are_those_of_their_formulas() -> None:
    true = np.array([[3.0, 0.5], [-3.0, -0.5]])
    off = np.array([[0.3, 0.0], [0.3, 0.5]])
    tip = np.array([[0.01, 0.02], [0.03, 0.04]])
    errors = Errors(np.arange(2), true, off, tip, tip / 2, np.array([1e-4, 3e-4]), tip)
    told = errors.told()
    assert told["r2_by_variance"] == pytest.approx(1 - 0.43 / 18.5, abs=1e-5)
    assert told["rmse_each"] == pytest.approx(np.sqrt((0.01 + 0.5) / 2), abs=1e-5)
    assert told["field_rmse_mm"] == pytest.approx(np.sqrt(2e-4), rel=1e-4)
    assert told["tip_median_percent"] == 2.5
    assert told["ceeq_p95_percent"] == pytest.approx(1.925)


def test_a_contest_that_was_cut_makes_only_what_is_missing_and_ends_alike(
    kept: Kept, tmp_path: Path
) -> None:
    made: list[int] = []
    pair = [one for one in own() if one.name in ("polynomial chaos", "extra trees")]

    def go(folder: Path, contestants: list[Contestant]) -> list[table.Row]:
        found = run.run(kept, 66, contestants, SHORT, seed=7, clock=clock, folder=folder)
        return table.rows(found)

    def clock() -> float:
        made.append(1)
        return float(len(made))

    whole = go(tmp_path / "whole", pair)
    timed = len(made)
    go(tmp_path / "cut", pair[:1])
    (folder,) = (tmp_path / "cut").iterdir()
    for file in sorted(folder.glob("raw-*"))[::3]:
        file.unlink()
    again = go(tmp_path / "cut", pair)
    assert strip(again) == strip(whole)
    made.clear()
    assert go(tmp_path / "cut", pair) == again
    assert made == []
    assert timed > 0
    assert [row["control"] for row in whole] == 4 * [False] + 8 * [True]
    assert table.best(whole)["name"] == whole[0]["name"]


def strip(rows: list[table.Row]) -> list[table.Row]:
    return [{k: v for k, v in row.items() if k != "seconds_per_million"} for row in rows]


def test_other_runs_another_seed_and_another_plan_are_other_contests(kept: Kept) -> None:
    digests = {
        run.digest(kept, 66, PLAN, 7),
        run.digest(kept, 65, PLAN, 7),
        run.digest(kept, 66, PLAN, 8),
        run.digest(kept, 66, trial.QUICK, 7),
        run.digest(replace(kept, x=kept.x + 1e-9), 66, PLAN, 7),
    }
    assert len(digests) == 5
    assert run.digest(kept, 66, PLAN, 7) in digests


def test_who_is_not_installed_is_named_and_the_others_go_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(boosters, "find_spec", lambda name: None if name == "xgboost" else name)
    able, missing = run.chosen(())
    assert (len(able), missing) == (6, ["XGBoost"])
    able, missing = run.chosen(["XGBoost", "extra trees"])
    assert ([one.name for one in able], missing) == (["extra trees"], ["XGBoost"])
    with pytest.raises(InputError, match=r"\['forest'\] are no contestants"):
        run.chosen(["forest"])


def test_too_few_independent_runs_are_refused(kept: Kept, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="leaves 1 of 100 runs"):
        run.run(kept, 99, own(), PLAN, seed=7, clock=float, folder=tmp_path)


def test_the_size_on_the_whole_mesh_is_that_of_bases_made_there(
    archive: Archive, kept: Kept
) -> None:
    every, runs = keep(archive, range(30), nodes=300, seed=3), np.arange(30)
    small, _ = Features.of(targets(kept, "raw"), runs, 12, 1)
    big, _ = Features.of(targets(every, "raw"), runs, 12, 1)
    assert big.nbytes_on(300, 300) == big.nbytes
    assert small.nbytes_on(len(kept.nodes), 300) == pytest.approx(big.nbytes, rel=0.2)
