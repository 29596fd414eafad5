"""Monomials: against their definition, and the same bits whoever makes the products."""

from __future__ import annotations

import subprocess
import sys
from hashlib import sha256

import numpy as np
import pytest

from core import monomials as made
from core.monomials import monomials, multi_indices
from core.monomials_compiled import LANES

SHAPES = [(1, 1, 0), (3, 4, 0), (1, 5, 6), (7, 2, 3), (8, 8, 2), (1029, 8, 2), (130, 6, 5)]


def points(n: int, d: int) -> np.ndarray:
    return np.random.default_rng(n + d).uniform(-1.2, 1.2, (n, d))


@pytest.mark.parametrize(("n", "d", "degree"), SHAPES)
def test_each_is_the_product_of_its_powers(n: int, d: int, degree: int) -> None:
    z = points(n, d)
    exact = np.prod(z[:, None, :] ** multi_indices(d, degree), axis=2)
    assert monomials(z, degree) == pytest.approx(exact, rel=1e-14, abs=1e-15)


@pytest.mark.parametrize(("n", "d", "degree"), SHAPES)
def test_arrays_and_the_compiled_function_give_the_same_bits(n: int, d: int, degree: int) -> None:
    z = points(n, d)
    by_arrays = np.empty((n, len(multi_indices(d, degree))))
    made._in_arrays(z, degree, by_arrays)
    assert "numba" in sys.modules
    assert np.array_equal(monomials(z, degree), by_arrays)


@pytest.mark.parametrize("n", range(1, 2 * LANES + 2))
def test_a_point_does_not_know_its_neighbours(n: int) -> None:
    z = points(40, 5)
    assert np.array_equal(monomials(z[:n], 4), monomials(z, 4)[:n])
    assert np.array_equal(monomials(np.asfortranarray(z)[::2][:n], 4), monomials(z[::2][:n], 4))


def test_what_is_not_finite_stays_where_it_is() -> None:
    z = points(12, 3)
    z[4, 1] = np.nan
    sound = np.isfinite(monomials(z, 3)).all(axis=1)
    assert np.flatnonzero(~sound).tolist() == [4]


def test_a_process_without_numba_has_the_same_bits_and_goes_on_without() -> None:
    code = """if True:
        import sys
        from hashlib import sha256
        import numpy as np
        from core.monomials import monomials
        z = np.random.default_rng(5).uniform(-1, 1, (300, 6))
        found = monomials(z, 4)
        assert "numba" not in sys.modules
        print(sha256(found.tobytes()).hexdigest())
    """
    told = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.strip()
    z = np.random.default_rng(5).uniform(-1, 1, (300, 6))
    assert told == sha256(monomials(z, 4).tobytes()).hexdigest()
