"""Where the scan expects a posterior with an effect, and what it then costs to find it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from core.calibration.online import RotorSpec, Workspace, begun, update
from core.calibration.scans import Dense
from core.calibration.start import Start
from core.calibration.state import RotorState
from core.calibration.step import Step
from core.diagnosis import Case, Facts
from core.diagnosis.adopt import amplitude, with_effects
from core.diagnosis.expected import _quieter, joined, without
from core.diagnosis.scan import Scan
from core.model import Model
from tests.core.calibration.bar import bar, measured
from tests.core.diagnosis.fleet import SIGMA, rotor
from tests.core.diagnosis.test_diagnose import MODEL as BENT
from tests.core.diagnosis.test_diagnose import OFFSET, readings
from tests.core.diagnosis.test_diagnose import SPEC as BENT_SPEC

MODEL, BLADES = bar(), 14
SPEC = RotorSpec("r", tuple(f"b{b}" for b in range(BLADES)), 1000, 3)
ADDED, NOISE = 0.012, 0.004


def torn() -> Case:
    """Every second blade is read by a gauge that reads three noises too much, late readings too."""
    clean = measured(BLADES, (0.6e4, 1.1e4, 1.5e4), seed=5, sd=NOISE)
    data = [
        replace(r, instrument=gauge, values=r.values + ADDED * (gauge == "g1"))
        for i, r in enumerate(clean)
        for gauge in [f"g{(i // 3 + i) % 2}"]
    ]
    return Case(SPEC, tuple(data), {b: Facts() for b in SPEC.blades}, (OFFSET,))


@dataclass(frozen=True)
class Torn:
    """The case, calibrated without the effect and with it.

    i       the cell of the effect in the scan
    bigger  the model with it, `alone` its calibration from nothing in a workspace of its own, and
            the columns that its evidence took there
    """

    case: Case
    state: RotorState
    scan: Scan
    i: int
    noise: dict[str, float]
    bigger: Model
    alone: Step
    evidence: float
    columns: int


@pytest.fixture(scope="module")
def it() -> Torn:
    case, work = torn(), Workspace()
    state = update(MODEL, SPEC, case.readings)
    scan, noise = case.scan(MODEL, state), case.noise(MODEL, state)
    i = next(i for i, c in enumerate(scan.cells) if c.value == "g1")
    bigger = with_effects(MODEL, [scan.cells[i]], case.facts, noise)
    alone = begun(bigger, SPEC, case.readings, workspace=work)
    evidence = alone.log_evidence
    return Torn(case, state, scan, i, noise, bigger, alone, evidence, work.columns.computed)


def test_amplitude_rate_and_noise_with_an_effect_are_foreseen(it: Torn) -> None:
    """The noise falls by several of its sds, which tells most of where the effect's place is."""
    expected = joined(MODEL, it.state, it.scan, [it.i], MODEL, it.noise)
    found = Start.of(it.bigger, it.alone.sealed())
    order = [found.names.index(n) for n in expected.names]
    sd = np.sqrt(np.diag(found.covariance))[order]
    assert np.all(np.abs(expected.mean - found.mean[order]) < 1.5 * sd)
    before, name = Start.of(MODEL, it.state), "sigma_obs.y"
    fall = before.mean[before.names.index(name)] - found.mean[found.names.index(name)]
    assert fall > 3 * sd[expected.names.index(name)]
    assert expected.mean[-1] == pytest.approx(ADDED, abs=3 * sd[-1])


def test_it_is_found_there_with_the_same_evidence_and_few_columns(it: Torn) -> None:
    work = Workspace()
    expected = joined(MODEL, it.state, it.scan, [it.i], MODEL, it.noise)
    near = begun(it.bigger, SPEC, it.case.readings, workspace=work, start=expected)
    assert near.log_evidence == pytest.approx(it.evidence, abs=0.15)
    assert 3 * work.columns.computed <= it.columns


def test_without_the_effect_the_model_as_it_was_is_expected(it: Torn) -> None:
    back = without(it.bigger, it.alone.sealed(), [it.scan.cells[it.i]], MODEL)
    known = Start.of(MODEL, it.state)
    assert back.names == known.names
    assert amplitude(it.scan.cells[it.i], MODEL.network)[0] not in back.names
    rate = known.names.index("rate")
    assert abs(back.mean[rate] - known.mean[rate]) < 1.0 * np.sqrt(known.covariance[rate, rate])


def test_what_wakes_is_expected_about_where_it_slept() -> None:
    """An input whose nominal value is 0.4, and acts by 0.25 more."""
    parameters = tuple(
        replace(p, nominal=0.4) if p.name == "bend" else p for p in BENT.network.parameters
    )
    model = Model(replace(BENT.network, parameters=parameters), BENT.surrogate)
    data = readings(lambda b, t: 0.65 * t**2)
    case = Case(BENT_SPEC, data, {b: Facts() for b in BENT_SPEC.blades})
    state = update(model, BENT_SPEC, data)
    scan = case.scan(model, state)
    i = next(k for k, c in enumerate(scan.cells) if c.name == "bend")
    found = joined(model, state, scan, [i], model, case.noise(model, state))
    assert found.mean[found.names.index("bend")] == pytest.approx(0.65, abs=0.05)


@pytest.mark.parametrize("values", [0, 900])
def test_what_a_scan_tells_of_its_noise_alone_no_effect_changes(values: int) -> None:
    """An offset in one of three visits of 24 blades; blades tell `values` more of their noise."""
    seen, _ = rotor(5, lambda b, k: 0.5 * (k == 1))
    more = (Dense("sigma_obs.y", rss=values * SIGMA**2, dof=values),) if values else ()
    named = ("sigma_obs.y",) * 3
    rows = tuple(replace(r, sigma=(*named, *r.sigma[3:]), dense=more) for r in seen.rows)
    g = np.zeros((*seen.q.shape, 1))
    g[:, 1] = 0.5
    fall, whole = _quieter(replace(seen, rows=rows), g, np.ones(1), {"sigma_obs.y": SIGMA})
    left = seen.including(g, np.ones(1)).q
    alone, beside = np.sum(left**2) / np.sum(seen.q**2), values * len(rows) / SIGMA**2
    assert alone < 0.6, "the offset is most of what the readings are off"
    expected = (np.sum(left**2) + beside) / (np.sum(seen.q**2) + beside)
    assert fall["sigma_obs.y"] == pytest.approx(expected)
    assert whole == pytest.approx(expected)
    known = tuple(replace(r, sigma=(SIGMA,) * len(r.sigma), dense=()) for r in rows)
    assert _quieter(replace(seen, rows=known), g, np.ones(1), {})[1] == 1.0


def test_an_amplitude_is_surer_by_the_noise_of_the_rows_that_tell_it() -> None:
    """The second visit has a noise of its own and is off: that of the others falls less."""
    seen, _ = rotor(5, lambda b, k: 0.5 * (k == 1))
    own = ("sigma_obs.y", "sigma_obs.y@g", "sigma_obs.y")
    rows = tuple(replace(r, sigma=(*own, *r.sigma[3:])) for r in seen.rows)
    g = np.zeros((*seen.q.shape, 1))
    g[:, 1] = 0.5
    noise = dict.fromkeys(own, SIGMA)
    fall, whole = _quieter(replace(seen, rows=rows), g, np.ones(1), noise)
    assert fall["sigma_obs.y@g"] < 0.7 * fall["sigma_obs.y"]
    assert whole == pytest.approx(fall["sigma_obs.y@g"])
