"""What a comparison with a reference accepts."""

from __future__ import annotations

import numpy as np
import pytest

from core.validation.compare import CORRELATION, MEAN, SPREAD, Comparison


def comparison(mean: float, ratio: float, correlation: float) -> Comparison:
    """One blade, two columns; the second one differs."""
    off = np.array([[0.0, correlation], [correlation, 0.0]])
    return Comparison(
        ("a", "b"), ("B1",), np.array([[0.0, mean]]), np.array([[1.0, ratio]]), off[None]
    )


def test_differences_within_the_acceptance_are_none() -> None:
    told = comparison(-MEAN, 1 - SPREAD + 1e-12, CORRELATION).beyond()
    assert told == {"mean": [], "ratio": [], "correlation": []}


@pytest.mark.parametrize(
    ("what", "given"), [("mean", (0, 1)), ("ratio", (1, 0)), ("correlation", (2, 0))]
)
@pytest.mark.parametrize("value", [float("nan"), float("inf"), 0.2])
def test_what_is_beyond_or_no_number_is_named(
    what: str, given: tuple[int, int], value: float
) -> None:
    differences = [0.0, 1.0, 0.0]
    at, centre = given
    differences[at] = centre + value
    told = comparison(*differences).beyond()
    assert [len(told[name]) for name in told] == [int(name == what) for name in told]
    assert "b" in told[what][0]
