"""Finite-element rotors: the design, whole rotors only, and the shipped ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from core.blade import BOUNDS, simulate
from core.errors import ModelError
from core.validation import fe_rotors
from core.validation.fe_rotors import BLADES, ROTORS, SCAN_H, design, load, make, place, times


def test_one_rate_in_each_slice_of_its_prior_and_one_for_all_blades_of_a_rotor() -> None:
    x = design()
    rate = x[:, :, list(BOUNDS).index("t1t_rate")]
    assert np.ptp(rate, axis=1).max() == 0
    assert sorted(((rate[:, 0] - 0.8) / 0.2 * ROTORS).astype(int)) == list(range(ROTORS))
    coating = x[:, :, 0].ravel()
    assert abs(coating.mean() - 1) < 4 * (2 / 3) / np.sqrt(12 * coating.size)


def test_only_whole_rotors_are_collected(tmp_path: Path) -> None:
    own = place(tmp_path)
    own.mkdir()
    run = {"elongation": np.linspace(0, 1, len(times())), "ceeq": np.zeros(len(times()))}
    for index in range(2 * BLADES - 1):
        more = {} if index % BLADES else {"deformation": np.ones((len(SCAN_H), 300, 3))}
        np.savez(own / f"{index:04d}.npz", **run, **more)
    made = make(tmp_path, tmp_path / "out.npz")
    assert made.inputs.shape == (1, BLADES, 4)
    assert made.at("elongation", 0, 50_000.0).tolist() == [1.0] * BLADES
    with pytest.raises(ModelError, match="no instant"):
        made.at("elongation", 0, 123.0)
    (own / "0003.npz").unlink()
    with pytest.raises(ModelError, match="no whole rotor"):
        make(tmp_path, tmp_path / "none.npz")
    with pytest.raises(ModelError, match="bladetwin study rotors"):
        load(tmp_path / "missing.npz")


def test_the_shipped_rotors_are_runs_of_this_code() -> None:
    """One blade run again on the first instants gives what is shipped."""
    shipped = load()
    assert fe_rotors.SHIPPED.stat().st_size < 3e6
    index = int(np.flatnonzero(np.isin(design()[:, 0, 1], shipped.inputs[0, 0, 1]))[0])
    np.testing.assert_array_equal(shipped.inputs[0], design()[index])
    t = shipped.time_h[:8]
    run = simulate(dict(zip(BOUNDS, map(float, shipped.inputs[0, 0]), strict=True)), time_h=t)
    np.testing.assert_allclose(run.elongation, shipped.elongation[0, 0, :8], rtol=2e-3, atol=1e-6)
