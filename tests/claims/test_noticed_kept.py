"""The kept study of sizes that would have been noticed: effects of them are."""

from __future__ import annotations

import json

import numpy as np

from core.diagnosis.noticed import PROBABILITY
from tests.claims.make_noticed import CELLS, FILE
from tests.claims.words import WORDS

KEPT = json.loads(FILE.read_text())
RECORDS = KEPT["records"]
PLANTED = [one for one in RECORDS if "alarms" in one]


def test_every_set_and_effect_is_there() -> None:
    asked = [(one["set"], one["condition"]) for one in RECORDS]
    assert asked == [(n, c) for n in range(KEPT["sets"]) for c in CELLS]
    assert KEPT["seed"] == int(KEPT["commit"][:6], 16)
    assert KEPT["planted"] == len(PLANTED)
    left = [one for one in RECORDS if "alarms" not in one]
    assert all(one["size"] is None or one["noises"] is None for one in left)


def test_effects_of_the_told_size_are_noticed_as_often_as_is_told_and_half_of_it_is_not() -> None:
    """Two standard errors of nine in ten; the control has to fail."""
    noticed = float(np.mean([one["alarms"] for one in PLANTED]))
    half = float(np.mean([one["half"] for one in PLANTED]))
    error = (PROBABILITY * (1.0 - PROBABILITY) / len(PLANTED)) ** 0.5
    assert KEPT["probability"] == PROBABILITY
    assert (KEPT["noticed"], KEPT["half as large"]) == (noticed, half)
    assert noticed > PROBABILITY - 2.0 * error
    assert half < PROBABILITY - 2.0 * error
    told = f"{sum(one['alarms'] for one in PLANTED)} of {len(PLANTED)}"
    control = f"{sum(one['half'] for one in PLANTED)} of {len(PLANTED)}"
    assert f"**{told}** are noticed, of those half as large {control}" in WORDS
