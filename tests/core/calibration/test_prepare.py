"""Rows of inputs that run in time, compiled for all readings at once."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from core.calibration.responses import prepare
from core.calibration.target import assemble
from core.diagnosis import Facts
from core.diagnosis.adopt import with_effects
from core.diagnosis.families import FAMILIES
from core.diagnosis.grammar import Cell
from core.model import Model, rotor_blade_wide
from core.observation import Inspection
from core.surrogate.driven import Driven
from core.validation.fe_rotors import scan_nodes

HOURS, BLADES = (0.0, 7e3, 8.1e3, 2.1e4), ("B1", "B2")


def worn() -> Model:
    """Coatings wear."""
    wear = Cell(next(f for f in FAMILIES if f.name == "coating wear"), "linear", "all")
    return with_effects(
        rotor_blade_wide(), [wear], {b: Facts() for b in BLADES}, {"elongation": 0.02}
    )


def readings(blade: str) -> list[Inspection]:
    """Lengths at four hours, one of them 0; scans at two, of two sets of nodes."""
    rng, found = np.random.default_rng(3), []
    for t in HOURS:
        found.append(Inspection(f"{blade}-{t}", blade, "elongation", t, np.array([1e-5 * t])))
    for t, nodes in zip(HOURS[1:3], (scan_nodes(4), scan_nodes(6)), strict=True):
        values = 0.1 + 0.01 * rng.normal(size=(len(nodes), 3))
        found.append(Inspection(f"{blade}+{t}", blade, "deformation", t, values, nodes))
    return found


def test_lengths_and_scans_of_all_hours_are_compiled_once_to_the_same_bits(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made, whole = [], Driven.compiled

    def counted(self: Driven, wanted: Any, times: Any, *more: Any, **named: Any) -> Any:
        made.append((len(wanted), list(times)))
        return whole(self, wanted, times, *more, **named)

    monkeypatch.setattr(Driven, "compiled", counted)
    model, alone = worn(), worn()
    prepare(model, [r for b in BLADES for r in readings(b)])
    assert made == [(3, list(HOURS[1:]))], "nothing has grown at hour 0"
    for blade in BLADES:
        one, other = (assemble(m, readings(blade)) for m in (model, alone))
        assert one is not None
        assert other is not None
        for part in ("a", "b", "log_v"):
            mine, same = (getattr(each.polynomials, part) for each in (one, other))
            assert np.array_equal(mine, same)
        assert np.array_equal(one.y, other.y)
        assert np.array_equal(one.extra, other.extra)
    assert len(made) == 1 + 2 + 5, "hour 0 each, and the other model's one by one"
    prepare(model, readings("B1"))
    assert len(made) == 8, "all is there"
