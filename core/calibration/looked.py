"""What looks at all visits of a rotor tell (`cavity`), once the nodes are placed.

    exchanged  pairs of blades whose readings of a visit are likelier the other way round
    noisier    kinds of visits that scatter more than their noise says

Both are told with a state's health. They are looked at twice, before blades are tried with a floor
(`doubted`) and once the nodes are settled, which are seldom others then.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from core.calibration.exchanged import Kept, exchanged, looks
from core.calibration.message import BladeMessage
from core.calibration.noisier import Looks, Scatter, scatter
from core.calibration.weighed import Weighed
from core.observation import Inspection

Told = Mapping[str, Sequence[Mapping[str, Any]]]
TOLD = ("exchanged", "noisier")


@dataclass(frozen=True, slots=True)
class Looked:
    """Looks at some nodes, how far they are off, and the exchanges."""

    looks: Looks
    scatter: Scatter
    exchanged: list[dict[str, Any]]

    @property
    def paired(self) -> set[str]:
        """Blades that look exchanged."""
        return {blade for pair in self.exchanged for blade in pair["blades"]}

    def told(self) -> Told:
        """For a state's health."""
        return dict(zip(TOLD, (self.exchanged, self.scatter.told(self.paired)), strict=True))


@dataclass(frozen=True)
class Looking:
    """The looks of one update.

    messages     of the blades that were read
    messages_of  the same of blades with other readings
    kept         looks of updates before
    """

    messages: Mapping[str, BladeMessage]
    messages_of: Callable[[Mapping[str, Sequence[Inspection]]], Mapping[str, BladeMessage]]
    kept: Kept
    _found: list[tuple[Weighed, frozenset[str], Looked]] = field(default_factory=list)

    def at(self, made: Weighed, accused: Sequence[Mapping[str, Any]]) -> Looked:
        """Near the best of these nodes, where these blades contradict."""
        bad = frozenset(one["blade"] for one in accused)
        for nodes, blades, found in self._found:
            if nodes is made and blades == bad:
                return found
        seen = looks(self.messages, made, self.kept)
        off = scatter(seen, bad)
        pairs = exchanged(self.messages, made, bad, self.messages_of, seen, off)
        self._found.append((made, bad, Looked(seen, off, pairs)))
        return self._found[-1][-1]


def told_of(health: Mapping[str, Any], unread: frozenset[str] | set[str] | None = None) -> Told:
    """What a state's health told; `unread`: of exchanges those that are of these blades alone.

    >>> told_of({"exchanged": [{"blades": ["a", "b"]}]}, {"a"})
    {'exchanged': [], 'noisier': []}
    """
    told = {name: list(health.get(name, ())) for name in TOLD}
    if unread is not None:
        told["exchanged"] = [one for one in told["exchanged"] if unread.issuperset(one["blades"])]
    return told
