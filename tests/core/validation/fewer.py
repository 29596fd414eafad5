"""Plans of rotors with effects, of some of their blades."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from core.validation.effect_plans import Plan


def of_blades(whole: Plan, which: Sequence[int]) -> Plan:
    """The plan as if the rotor had these blades alone."""
    own = list(which)
    ahead, shares = whole.horizon, whole.horizon_shares
    return replace(
        whole,
        offset_h=whole.offset_h[own],
        coat=whole.coat[own],
        elongation=whole.elongation[:, own],
        shares={name: share[:, own] for name, share in whole.shares.items()},
        horizon=None if ahead is None else ahead[:, own],
        horizon_shares=None if shares is None else {n: s[:, own] for n, s in shares.items()},
    )
