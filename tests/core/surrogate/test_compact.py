"""Modes in sixteen bits: how far off, that twice is once, and that a file keeps every bit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from core.errors import ModelError
from core.surrogate import Surrogate, load, save
from core.surrogate import compact as module
from core.surrogate.artefact import digest_of
from core.surrogate.compact import SHARE, compact, packed, unpacked


@pytest.fixture
def large(model: Surrogate, monkeypatch: pytest.MonkeyPatch) -> Surrogate:
    monkeypatch.setattr(module, "LARGE", 1000)
    return compact(model)


def test_what_rounding_adds_is_a_twentieth_of_what_truncation_left(
    model: Surrogate, large: Surrogate
) -> None:
    """Of the fields that the training runs' coefficients make; and twice is once."""
    for name, part in large.parts.items():
        before, after = model.parts[name].factors, part.factors
        assert after.space.dtype == np.float32
        (c,) = model.process.mean(model.process.z, [part.columns])
        rows = np.arange(len(before.space))
        off = after.decode(c, after.time_h, rows) - before.decode(c, before.time_h, rows)
        cut = np.sqrt(np.mean(part.cut_time**2) * np.mean(part.cut_space.astype(float) ** 2))
        held = module._amplitude(part, model.process) * module._finest(before.space)
        allowed = np.hypot(SHARE * cut, np.sqrt(np.sum(held**2) / 12.0))  # sixteen bits at most
        assert np.sqrt(np.mean(off**2)) < 1.3 * allowed
    assert digest_of(large) != digest_of(model)
    assert digest_of(compact(large)) == digest_of(large)


def test_what_it_predicts_hardly_moves(model: Surrogate, large: Surrogate) -> None:
    """Far less than its own sd; the stand-in's modes are too smooth for sixteen bits, though."""
    rng = np.random.default_rng(2)
    low, high = (np.array([getattr(i, end) for i in model.inputs]) for end in ("low", "high"))
    x = low + (high - low) * rng.random((20, len(low)))
    times = model.time_h[model.time_h > 0][::4]
    for quantity in model.quantities:
        mean, sd = model.predict(x, quantity, times)
        same, band = large.predict(x, quantity, times)
        allowed = 0.1 * np.sqrt(np.mean(sd**2)) + 1e-3 * np.sqrt(np.mean(mean**2))
        assert np.sqrt(np.mean((same - mean) ** 2)) < allowed
        assert np.sqrt(np.mean((band - sd) ** 2)) < 0.05 * np.sqrt(np.mean(sd**2))


def test_a_file_of_half_the_size_keeps_every_bit(
    model: Surrogate, large: Surrogate, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = save(large, tmp_path / "small")
    found = load(tmp_path / "small")
    assert found.digest == kept.digest == digest_of(large)
    for name, part in large.parts.items():
        assert np.array_equal(found.parts[name].factors.space, part.factors.space)
    with np.load(tmp_path / "small" / "arrays.npz") as stored:
        assert "deformation/space16" in stored.files
        assert "deformation/space" not in stored.files
    again = (tmp_path / "small" / "arrays.npz").read_bytes()
    save(found, tmp_path / "again")
    assert (tmp_path / "again" / "arrays.npz").read_bytes() == again
    monkeypatch.undo()
    save(model, tmp_path / "plain")
    assert len(again) < 0.7 * (tmp_path / "plain" / "arrays.npz").stat().st_size


def test_a_changed_integer_and_a_lost_step_are_found(large: Surrogate, tmp_path: Path) -> None:
    save(large, tmp_path)
    file = tmp_path / "arrays.npz"
    with np.load(file) as stored:
        arrays = {name: stored[name] for name in stored.files}
    changed = arrays["ceeq/space16"].copy()
    changed[0, 0] += 1
    np.savez_compressed(file, **arrays | {"ceeq/space16": changed})
    with pytest.raises(ModelError, match="is damaged"):
        load(tmp_path)
    np.savez_compressed(file, **{n: a for n, a in arrays.items() if n != "ceeq/step"})
    with pytest.raises(ModelError, match="no readable"):
        load(tmp_path)


def test_small_models_and_modes_that_are_not_rounded_are_stored_as_they_are(
    model: Surrogate, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert compact(model) is model
    space = np.random.default_rng(1).normal(size=(50, 3)).astype(np.float32)
    space[:, 2] = 0.0
    monkeypatch.setattr(module, "LARGE", 10)
    assert packed({"a/space": space}).keys() == {"a/space"}
    step = 4.0 * module._finest(space)
    rounded = module._expanded(np.rint(space / step).astype(np.int16), step)
    there = packed({"a/space": rounded, "b": space})
    assert there.keys() == {"a/space16", "a/step", "b"}
    assert there["a/step"][:2] == pytest.approx(step[:2])
    back = unpacked(there)
    assert np.array_equal(back["a/space"], rounded)
    assert back["a/space"].flags.c_contiguous
