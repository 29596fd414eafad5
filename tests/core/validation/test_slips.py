"""The study of slips: what is written down wrongly, and what is counted."""

from __future__ import annotations

import numpy as np
import pytest

from core.errors import InputError
from core.observation import Inspection
from core.rng import stream
from core.validation import slips


def readings() -> list[Inspection]:
    return [
        Inspection(f"r{b}{v}", f"b{b}", "elongation", 1e3, np.array([0.41 + 0.1 * b]), campaign=v)
        for b in range(3)
        for v in ("c1", "c2")
    ]


@pytest.mark.parametrize(
    ("kind", "becomes"),
    [
        ("inches", lambda v: v / 25.4),
        ("decimal", lambda v: 10 * v),
        ("sign", lambda v: -v),
        ("digits", slips.turned),
    ],
)
def test_one_reading_is_written_down_wrongly(kind: str, becomes: object) -> None:
    before = readings()
    after, wrong, off = slips.slipped(kind, before, stream(1, kind))
    differ = [(a, b) for a, b in zip(before, after, strict=True) if a != b]
    ((a, b),) = differ
    assert (wrong, b.id) == ((a.id,), a.id)
    assert callable(becomes)
    assert b.values[0] == pytest.approx(becomes(a.values[0]))
    assert off == pytest.approx(abs(b.values[0] - a.values[0]) / slips.NOISE)


def test_two_blades_of_a_visit_are_swapped() -> None:
    before = readings()
    after, wrong, off = slips.slipped("swapped", before, stream(2, "x"))
    first, second = (next(r for r in before if r.id == name) for name in wrong)
    told = {r.id: float(r.values[0]) for r in after}
    assert first.campaign == second.campaign
    assert first.blade != second.blade
    assert told[first.id] == second.values[0]
    assert told[second.id] == first.values[0]
    assert off > 0
    assert sum(a != b for a, b in zip(before, after, strict=True)) == 2


def test_a_slip_lies_within_its_sizes() -> None:
    offs = [slips.slipped("slip", readings(), stream(k, "s"))[2] for k in range(50)]
    assert min(offs) >= slips.SLIP[0]
    assert max(offs) <= slips.SLIP[1]


def test_every_case_counts_and_small_ones_apart() -> None:
    case = {"kind": "sign", "right": True, "among": True, "named": False}
    moved = [(20.0, 0.1, 6.0), (30.0, -2.0, -9.0), (3.0, 0.4, 0.4)]
    found = [case | {"off": o, "moved": m, "unbounded": u} for o, m, u in moved]
    own = slips.table(found)["sign"]
    assert own == slips.table(found)["all"]
    assert (own["cases"], own["large"], own["right"], own["named"]) == (3, 2, 1.0, 0.0)
    assert own["moved, most"] == 2.0
    assert own["moved, above 1 sd"] == 0.5
    assert own["unbounded, median"] == 7.5
    assert own["small, moved at most"] == 0.4


def test_an_unknown_kind_is_refused() -> None:
    with pytest.raises(InputError, match="use inches, decimal"):
        slips.run({"ounces": 1}, seed=1, particles=64)
    with pytest.raises(InputError, match="use each, clean, "):
        slips.run({"sign": 1}, seed=1, particles=64, condition="rust")


def test_exchanges_are_counted_where_they_were_looked_for() -> None:
    case = {"kind": "swapped", "off": 3.0, "moved": 0.1, "unbounded": 0.1}
    told = [(True, 1, 0), (True, 2, 0), (False, 0, 1), (False, 0, 0)]
    names = ("exchange told", "exchanges", "exchanges before")
    found = [case | dict(zip(names, one, strict=True)) for one in told]
    own = slips.table(found)["all"]
    assert [own[f"exchange{what}"] for what in (" told", "s told wrongly", "s told before")] == [
        0.5, 1.0, 1.0,
    ]  # fmt: skip
    assert "exchange told" not in slips.table([case])["all"], "of studies of before"


def test_a_case_whose_slip_is_large_names_the_reading() -> None:
    """One finite-element rotor of twenty blades, a sign forgotten."""
    told = slips.one("sign", 0, 5, 256, "rotor-20")
    assert told["off"] > slips.NOTICED
    assert (told["right"], told["named"], told["accused before"]) == (True, True, 0)
    assert abs(told["moved"]) < 1.0


def test_two_blades_that_were_exchanged_are_told_and_a_worn_coating_is_no_exchange() -> None:
    told = slips.one("swapped", 0, 991, 256, "rotor-20", "wear")
    assert told["condition"] == "wear"
    assert (told["exchange told"], told["exchanges"], told["exchanges before"]) == (True, 1, 0)
    assert told["right"], "and neither carries the rotor's noise away"
    assert abs(told["moved"]) < 1.0
