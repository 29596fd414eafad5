"""The shipped artefact against finite-element runs it has not seen.

``test_runs.npz`` was taken by ``make_sample.py``: 34 elongation curves, and CEEQ and permanent
deformation at 50 nodes and 6 instants.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from core.blade import BOUNDS, output_times
from core.builtin import rotor_blade
from core.builtin.plans import SEED, TRAINING, design
from core.builtin.rotor_blade import MODEL, WIDE_MODEL, blade_digest, load
from core.builtin.shipped import WHOLE
from core.errors import ModelError
from core.surrogate import Surrogate
from core.surrogate.artefact import digest_of, whole_of
from core.surrogate.artefact import load as load_artefact

Array = NDArray[np.float64]
LATE = 15  # index of 1000 h


@pytest.fixture(scope="module")
def blade() -> Surrogate:
    return load()


@pytest.fixture(scope="module")
def sample() -> dict[str, Array]:
    with np.load(Path(__file__).with_name("test_runs.npz")) as stored:
        return {name: stored[name] for name in stored.files}


@pytest.fixture(scope="module")
def elongation(blade: Surrogate, sample: dict[str, Array]) -> tuple[Array, Array]:
    return blade.predict(sample["inputs"], "elongation", sample["time_h"])


@pytest.fixture(scope="module")
def ceeq(blade: Surrogate, sample: dict[str, Array]) -> tuple[Array, Array]:
    times = sample["time_h"][sample["instants"].astype(int)]
    return blade.predict(sample["inputs"], "ceeq", times, sample["nodes"].tolist())


@pytest.fixture(scope="module")
def deformation(blade: Surrogate, sample: dict[str, Array]) -> tuple[Array, Array]:
    times = sample["time_h"][sample["instants"].astype(int)]
    return blade.predict(sample["inputs"], "deformation", times, sample["nodes"].tolist())


def relative(found: Array, true: Array) -> tuple[float, float]:
    median, p95 = np.quantile(np.abs(found / true - 1), [0.5, 0.95])
    return float(median), float(p95)


def coverage(mean: Array, sd: Array, true: Array) -> float:
    return float(np.mean(np.abs(true - mean) <= 1.959964 * sd))


def test_tip_elongation_is_within_half_a_per_cent_and_two_and_a_half_at_the_95th_percentile(
    elongation: tuple[Array, Array], sample: dict[str, Array]
) -> None:
    for chosen in (slice(LATE, None), slice(-1, None)):
        found, true = elongation[0][:, chosen], sample["elongation"][:, chosen]
        median, p95 = relative(found, true)
        assert median <= 0.005
        assert p95 <= 0.025


def test_the_same_test_fails_when_the_runs_are_exchanged(
    elongation: tuple[Array, Array], sample: dict[str, Array]
) -> None:
    wrong = np.roll(sample["elongation"], 1, axis=0)
    assert relative(elongation[0][:, LATE:], wrong[:, LATE:])[0] > 0.2


def test_ceeq_at_the_worst_node_is_within_one_per_cent_and_four_at_the_95th_percentile(
    ceeq: tuple[Array, Array], sample: dict[str, Array]
) -> None:
    place = np.searchsorted(sample["nodes"], sample["worst"])
    runs = np.arange(len(place))
    late = sample["instants"] >= LATE
    found, true = (field[:, late][runs, :, place] for field in (ceeq[0], sample["ceeq"]))
    median, p95 = relative(found, true)
    assert median <= 0.01
    assert p95 <= 0.04


def test_the_deformation_is_within_a_hundredth_of_a_millimetre(
    deformation: tuple[Array, Array], sample: dict[str, Array]
) -> None:
    error = deformation[0] - sample["deformation"]
    assert np.sqrt(np.mean(error**2)) <= 0.01
    assert np.sqrt(np.mean(sample["deformation"] ** 2)) > 0.1


def test_its_own_95_per_cent_intervals_cover_90_to_99_per_cent(
    elongation: tuple[Array, Array],
    ceeq: tuple[Array, Array],
    deformation: tuple[Array, Array],
    sample: dict[str, Array],
    blade: Surrogate,
) -> None:
    mean, sd = elongation
    assert 0.90 <= coverage(mean[:, 1:], sd[:, 1:], sample["elongation"][:, 1:]) <= 0.99
    # 50 nodes are a sample of the field: a wider band here, the whole field in the manifest
    assert 0.85 <= coverage(*ceeq, sample["ceeq"]) <= 0.995
    assert 0.85 <= coverage(*deformation, sample["deformation"]) <= 0.995
    for name in ("elongation", "ceeq", "deformation"):
        assert 0.90 <= blade.manifest["errors"][name]["coverage_95"] <= 0.99


def test_intervals_of_a_quarter_of_the_width_do_not_cover(
    elongation: tuple[Array, Array], sample: dict[str, Array]
) -> None:
    mean, sd = elongation
    assert coverage(mean[:, 1:], sd[:, 1:] / 4, sample["elongation"][:, 1:]) < 0.75


def test_the_manifest_tells_what_is_measured_here(
    blade: Surrogate, elongation: tuple[Array, Array], sample: dict[str, Array]
) -> None:
    told = blade.manifest["errors"]["elongation"]
    median, p95 = relative(elongation[0][:, LATE:], sample["elongation"][:, LATE:])
    assert told["from_1000_h"]["median_percent"] == pytest.approx(100 * median, abs=2e-3)
    assert told["from_1000_h"]["p95_percent"] == pytest.approx(100 * p95, abs=2e-3)
    mean, sd = elongation
    inside = coverage(mean[:, 1:], sd[:, 1:], sample["elongation"][:, 1:])
    assert told["coverage_95"] == pytest.approx(inside, abs=2e-3)


def test_the_sample_is_of_the_declared_design(blade: Surrogate, sample: dict[str, Array]) -> None:
    np.testing.assert_allclose(sample["inputs"], design()[TRAINING:], rtol=1e-12)
    assert blade.manifest["seed"] == SEED
    assert blade.manifest["mesh"] == "default"
    assert blade.manifest["runs"] == {"training": 66, "test": 34}
    assert blade.manifest["command"] == "bladetwin model build rotor-blade"
    assert len(blade.manifest["finite_elements"]["digest"]) == len(blade_digest())


def test_the_artefact_covers_the_blades_inputs_and_instants(blade: Surrogate) -> None:
    found = {item.name: (item.low, item.high) for item in blade.inputs}
    assert list(found.items()) == list(BOUNDS.items())
    np.testing.assert_array_equal(blade.time_h, output_times())
    assert blade.horizon_h == 50_000.0
    assert set(blade.quantities) == {
        "ceeq",
        "creep_damage",
        "mises",
        "displacement",
        "deformation",
        "elongation",
    }
    assert set(blade.named) == {"tip", "critical"}


def test_the_artefact_is_small_and_its_digest_is_that_of_its_content(blade: Surrogate) -> None:
    assert sum(file.stat().st_size for file in MODEL.iterdir()) <= 8_000_000
    assert digest_of(blade) == blade.digest == blade.manifest["digest"]


def test_the_release_knows_the_manifests_that_it_ships() -> None:
    for folder in (MODEL, WIDE_MODEL):
        assert whole_of(json.loads((folder / "manifest.json").read_text())) == WHOLE[folder.name]


def test_a_changed_note_of_a_shipped_model_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Even where its own digest was made to fit."""
    copy = tmp_path / MODEL.name
    shutil.copytree(MODEL, copy)
    manifest = json.loads((copy / "manifest.json").read_text())
    manifest["runs"]["test"] = 340
    manifest["whole"] = whole_of(manifest)
    (copy / "manifest.json").write_text(json.dumps(manifest))
    assert load_artefact(copy).digest == load_artefact(MODEL).digest
    monkeypatch.setattr(rotor_blade, "MODEL", copy)
    with pytest.raises(ModelError, match=r"manifest\.json has digest .* this release says"):
        rotor_blade.load.__wrapped__()


def test_the_polynomials_add_less_than_a_third_of_the_surrogates_own_error(
    blade: Surrogate,
) -> None:
    told, own = blade.manifest["polynomials"], blade.manifest["errors"]
    assert told["degree"] == 6
    assert told["elongation"]["p95_percent"] < own["elongation"]["from_1000_h"]["p95_percent"] / 3
    x = np.random.default_rng(3).uniform(blade.low, blade.high, (500, 4))
    mean, _ = blade.predict(x, "elongation", [8000.0])
    found, _ = blade.response("elongation", [8000.0]).evaluate(x)
    assert np.quantile(np.abs(found / mean - 1), 0.95) < 0.002


def test_the_bases_lose_less_than_one_per_cent_of_creep_fields_left_out(blade: Surrogate) -> None:
    bases = blade.manifest["training"]["bases"]
    for name in ("mean_ceeq", "ceeq", "creep_damage", "deformation", "elongation"):
        assert bases[name]["held_out_percent"] < 1.0
        assert bases[name]["coefficients"] == blade.parts[name].factors.coefficients


def test_the_corners_of_the_box_are_within_three_of_its_own_standard_deviations(
    blade: Surrogate,
) -> None:
    """Finite elements at the two extreme corners: 8.50 and 0.055 mm after 50,000 h."""
    corners = np.array([[2 / 3, 1.0, 3.0, 3.0], [4 / 3, 0.8, -3.0, -3.0]])
    mean, sd = (v[:, 0] for v in blade.predict(corners, "elongation", [50_000.0]))
    assert np.all(np.abs(mean - [8.50, 0.055]) < 3 * sd + [0.005, 0.0005])
    assert np.all(sd < 0.2 * mean)


def test_the_process_won_the_contest(blade: Surrogate) -> None:
    table = blade.manifest["contest"]
    assert table[0]["name"] == "gaussian process"
    assert {"extra trees", "random forest", "cubic"} < {row["name"] for row in table}


@pytest.mark.parametrize(
    ("index", "sign"),
    [(0, -1.0), (1, 1.0), (2, 1.0), (3, 1.0)],
    ids=["tbc_thickness", "t1t_rate", "creep_transient", "creep_steady"],
)
def test_elongation_falls_with_the_coating_and_rises_with_the_other_inputs(
    blade: Surrogate, index: int, sign: float
) -> None:
    x = np.tile(0.5 * (blade.low + blade.high), (9, 1))
    x[:, index] = np.linspace(blade.low[index], blade.high[index], 9)
    mean, _ = blade.predict(x, "elongation", [50_000.0])
    assert np.all(sign * np.diff(mean[:, 0]) > 0)
