"""A blade of whose draws too few count is told, whichever way its state was come by."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from core.calibration.few import LEAST, few_draws, share
from core.calibration.message import BladeMessage
from core.calibration.online import update
from core.calibration.state import RotorState
from tests.core.calibration.test_bad_data import MODEL, SPEC, clean, reading

ROUGH = "b1"
Array = np.ndarray[Any, np.dtype[np.float64]]


@pytest.fixture
def rough() -> Iterator[None]:
    """One blade's draws as they come where the proposal lies beside the posterior."""
    drawn = BladeMessage.draws

    def lopsided(self: BladeMessage, *given: Any, **more: Any) -> tuple[Array, Array]:
        local, log_w = drawn(self, *given, **more)
        if self.rows.readings[0].blade == ROUGH:
            log_w = log_w - 20.0
            log_w[3, 5] = np.log(20.0)
        return local, log_w

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BladeMessage, "draws", lopsided)
        yield


def told(state: RotorState) -> Any:
    return state.meta["health"].get("few_draws", [])


def test_the_share_of_all_draws_counts_not_that_of_a_node() -> None:
    """One draw with the weight that all should have together, at one of 32 nodes: of the others
    nothing is amiss, and of all 3,200 four count."""
    log_w = np.full((32, 100), -np.log(100.0))
    assert share(log_w) == pytest.approx(1.0)
    log_w[7, 3] = np.log(32.0)
    assert share(log_w) * log_w.size == pytest.approx(4.0, abs=0.1)
    assert share(np.full((4, 5), -np.inf)) == 0.0


def test_a_blade_that_is_kept_has_the_share_of_before() -> None:
    even, odd = np.zeros((4, 100)), np.zeros((4, 100))
    odd[2, 2] = 50.0
    fresh = {"blade/a/log_w": even, "blade/b/log_w": odd, "column/b": odd}
    found = few_draws("abc", fresh)
    assert found == [{"blade": "b", "share": pytest.approx(1 / 400, rel=1e-3)}]
    assert few_draws("abc", {"blade/a/log_w": even}, found, {"b", "c"}) == found
    assert few_draws("abc", {"blade/a/log_w": even}, found, {"c"}) == []
    assert few_draws("abc", {"blade/b/log_w": even}, found, {"b"}) == [], "drawn anew"


def test_it_is_told_by_quick_and_sealed_states_alike(rough: None) -> None:
    state = update(MODEL, SPEC, clean())
    health = state.meta["health"]
    ((blade, value),) = ((one["blade"], one["share"]) for one in told(state))
    assert blade == ROUGH
    assert value < LEAST
    assert (health["status"], health["met_floor"]) == ("degenerate", False)
    assert f"of blade {ROUGH}'s draws" in health["reasons"][0]
    late = reading(5, 2.0, 0.1)
    quick = update(MODEL, SPEC, [*clean(), late], state, quick=True)
    assert not quick.sealed
    assert told(quick) == told(state), "carried with the blade's draws"
    sealed = update(MODEL, SPEC, [*clean(), late], quick)
    assert sealed.digest == update(MODEL, SPEC, [late, *clean()]).digest
    assert told(sealed)[0]["blade"] == ROUGH


def test_sound_draws_say_nothing() -> None:
    health = update(MODEL, SPEC, clean()).meta["health"]
    assert "few_draws" not in health
    assert health["status"] == "ok"
