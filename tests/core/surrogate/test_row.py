from __future__ import annotations

import numpy as np
import pytest

from core.errors import InputError, RangeError
from core.monomials import monomials, multi_indices
from core.rng import stream
from core.surrogate import Surrogate
from core.surrogate.contest.row import Row, kernel


@pytest.mark.parametrize(("d", "degree", "n"), [(4, 3, 131), (1, 5, 64), (2, 0, 3)])
def test_the_kernel_is_the_sum_of_monomials(d: int, degree: int, n: int) -> None:
    rng = stream(8, "row", d)
    z, c = rng.uniform(-1, 1, (n, d)), rng.standard_normal(len(multi_indices(d, degree)))
    low, half = np.full(d, 2.0), 0.25
    out = np.empty(n)
    kernel(d, degree)(low + half * (z + 1.0), low, np.full(d, 1.0 / half), c, out)
    assert out == pytest.approx(monomials(z, degree) @ c, abs=1e-12)


def test_a_row_is_the_surrogate_to_a_tenth_of_a_percent(model: Surrogate) -> None:
    x = stream(9, "row").uniform(model.low, model.high, (500, 4))
    for quantity, node in (("elongation", None), ("ceeq", model.named["critical"])):
        row = Row.of(model, quantity, 24_000.0, node)
        nodes = None if node is None else [node]
        exact = model.predict(x, quantity, [24_000.0], nodes)[0].reshape(-1)
        assert row.positive
        assert np.quantile(np.abs(row(x) / exact - 1.0), 0.95) < 1e-3
        assert Row.of(model, quantity, 24_000.0, node, 1)(x) != pytest.approx(exact, rel=1e-3)


def test_a_vector_a_field_without_a_node_and_too_many_terms_are_refused(model: Surrogate) -> None:
    with pytest.raises(InputError, match="is a vector field"):
        Row.of(model, "displacement", 8000.0, 3)
    with pytest.raises(InputError, match="for a field at a node"):
        Row.of(model, "ceeq", 8000.0)
    with pytest.raises(InputError, match="is unknown"):
        Row.of(model, "strain", 8000.0)
    with pytest.raises(RangeError, match="horizon"):
        Row.of(model, "elongation", 1e6)
    with pytest.raises(InputError, match="792 terms of 5 inputs, more than 500"):
        kernel(5, 7)
