"""The study of noises that are stated too small: what is read, and what is counted."""

from __future__ import annotations

import pytest

from core.errors import InputError
from core.validation import stated


def test_a_noise_of_half_is_told_and_the_right_one_is_not() -> None:
    """One finite-element rotor of twenty blades, with what is believed as the control."""
    right, half = (stated.one(times, 0, 20_261_201, 256, "rotor-20") for times in (1.0, 2.0))
    assert (right["told"], right["contradicted"], right["exchanges"]) == (0.0, 0, 0)
    assert right["exchanges believed"] == 0
    assert 1.5 <= half["told"] < 3.0
    assert half["exchanges"] == 0


def test_every_rotor_counts() -> None:
    case = {"contradicted": 1, "exchanges": 0, "exchanges believed": 0}
    found = [case | {"times": k, "told": s} for k, s in ((1.0, 0.0), (3.0, 2.4), (3.0, 2.8))]
    told = stated.table(found)
    assert list(told) == ["1", "3"]
    assert told["1"] == {
        "rotors": 1, "told": 0, "contradicted": 1, "exchanges": 0, "exchanges believed": 0,
    }  # fmt: skip
    assert (told["3"]["rotors"], told["3"]["least"], told["3"]["most"]) == (2, 2.4, 2.8)


def test_a_factor_out_of_range_is_refused() -> None:
    with pytest.raises(InputError, match=r"times.*use 0\.1 to 10"):
        stated.run(1, (0.0,), seed=1, particles=64)
