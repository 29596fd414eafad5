from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from core.archive import Archive, Run
from core.surrogate import Surrogate
from core.surrogate.report import errors, polynomial_error


def predicted(model: Surrogate, archive: Archive, path: Path, factor: float) -> Archive:
    """An archive whose three runs are the model's own predictions times a factor."""
    made = Archive.create(
        path,
        inputs=model.inputs,
        time_h=model.time_h,
        mesh=archive.mesh(),
        seed=0,
        command="predicted",
    )
    rng = np.random.default_rng(9)
    for k, x in enumerate(rng.uniform(model.low, model.high, (3, 4))):
        inputs = {item.name: float(v) for item, v in zip(model.inputs, x, strict=True)}
        values = {
            q.name: factor * model.predict(x, q.name, model.time_h)[0][0]
            for q in archive.declaration.quantities
        }
        made.write(k, Run(inputs, values))
    return made


def test_a_model_that_is_the_truth_has_no_error(
    model: Surrogate, archive: Archive, tmp_path: Path
) -> None:
    found = errors(model, predicted(model, archive, tmp_path, 1.0), range(3))
    assert found["elongation"]["from_1000_h"] == {"median_percent": 0.0, "p95_percent": 0.0}
    assert found["elongation"]["coverage_95"] == 1.0
    assert found["ceeq"]["worst_node_from_1000_h"]["p95_percent"] < 2e-4
    assert found["deformation"]["rmse_mm"] < 1e-6
    assert found["runs"] == 3


def test_a_truth_four_per_cent_above_is_reported_as_such(
    model: Surrogate, archive: Archive, tmp_path: Path
) -> None:
    found = errors(model, predicted(model, archive, tmp_path, 1.04), range(3))
    expected = 100 * (1 - 1 / 1.04)
    for part, key in (("elongation", "from_1000_h"), ("ceeq", "worst_node_at_horizon")):
        assert found[part][key]["median_percent"] == pytest.approx(expected, abs=2e-4)
        assert found[part][key]["p95_percent"] == pytest.approx(expected, abs=2e-4)
    assert found["elongation"]["coverage_95"] < 0.3
    assert found["deformation"]["rmse_mm"] > 1e-3


def test_the_polynomials_error_is_seeded_and_small(model: Surrogate) -> None:
    first = polynomial_error(model, samples=100, seed=4)
    assert first == polynomial_error(model, samples=100, seed=4)
    assert first["degree"] == 6
    assert 0 < first["elongation"]["max_percent"] < 0.1
    assert set(model.quantities) < set(first)
