"""Runs that are kept one by one: what is there is not computed again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from core.blade.kept import kept_runs


def test_a_cut_campaign_computes_what_is_missing_and_nothing_else(tmp_path: Path) -> None:
    todo = {"a": (3, 1.5), "b": (3, 2.5), "c": (3, 3.5)}
    told: list[tuple[int, int]] = []
    first = kept_runs(tmp_path, {"a": todo["a"]}, np.full, 1)
    assert first["a"].tolist() == [1.5] * 3
    np.save(tmp_path / "b.npy", np.array([9.0]))  # as if it had been computed
    done = kept_runs(tmp_path, todo, np.full, 2, lambda n, of: told.append((n, of)))
    assert list(done) == ["a", "b", "c"]
    assert done["b"].tolist() == [9.0]
    assert told == [(3, 3)]
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a.npy", "b.npy", "c.npy"]


def test_a_run_that_fails_ends_the_campaign_and_leaves_what_is_done(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="negative"):
        kept_runs(tmp_path, {"a": (2, 1.5), "bad": (-1, 0.0)}, np.full, 1)
    assert [file.name for file in tmp_path.iterdir()] == ["a.npy"]
