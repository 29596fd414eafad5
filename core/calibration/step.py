"""One update at work: messages of all blades at hand, and the way from them to a state (`online`).

A step knows what it rests on (`basis`), and is sealed at nodes that follow from the readings alone.
The quick way, at the nodes of the state before, is `quick`; what both take is kept in a
`Workspace`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.calibration.alike import family_key
from core.calibration.basis import Basis
from core.calibration.bounded import DOUBT, Accused, settled
from core.calibration.doubted import doubted
from core.calibration.few import few_draws
from core.calibration.health import blamed, verdict
from core.calibration.looked import Looking, Told
from core.calibration.message import BladeMessage
from core.calibration.rotor import weigh
from core.calibration.sets import Nodes
from core.calibration.smooth import NEARLY
from core.calibration.space import locals_of
from core.calibration.state import ALGORITHM, Arrays, RotorState, health
from core.calibration.surface import evening
from core.calibration.weighed import Weighed
from core.observation import Inspection
from core.rng import seed_of
from core.smc.particles import log_sum_exp
from core.smc.proposal import Proposal

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Step(Basis):
    """One update at work: what it rests on, and its sealed state."""

    @cached_property
    def settled(self) -> tuple[Weighed, Accused]:
        """The shared nodes with their weights, and the blades that contradict there."""
        if self.start is not None:
            return settled(self.messages, self.weigh_with, self.start.apart)
        return settled(self.messages, self.weigh_with, doubts=self._doubts)

    def _doubts(self, made: Weighed, accused: Accused) -> list[tuple[str, ...]]:
        found = self.looking.at(made, accused)
        return doubted(self.messages, found, DOUBT)

    @property
    def weighed(self) -> Weighed:
        """The shared nodes with their weights."""
        return self.settled[0]

    def weigh_with(self, floors: Mapping[str, float]) -> Weighed:
        """The nodes placed and weighted with these floors of what blades say."""
        seed, places = seed_of(self.rotor.seed, self.rotor.id, "nodes") % 2**63, self.work.places
        given = (self.space, self.messages, self.work.columns, seed)
        if places is None:
            return weigh(*given, start=self.start, floors=floors)
        key = self.question + "".join(f" {b}:{f!r}" for b, f in floors.items())
        told = places.get(key)
        placed = None if told is None else Proposal.of(told)
        made = weigh(*given, start=self.start, placed=placed, floors=floors)
        places[key] = made.proposal.told()
        return made

    @property
    def log_evidence(self) -> float:
        """By the nodes' weights, which a tilt leaves as they are."""
        return self.weighed.log_evidence

    def sealed(self, previous: RotorState | None = None) -> RotorState:
        """The state as a function of the readings alone; equal draws are taken from the last."""
        weighed = self.weighed
        if self.start is not None:  # weighed by near messages
            found = self.work.columns.gathered(self.messages)
            columns = self.work.columns.all(found, weighed.unit, "exact")
            weighed = replace(weighed, columns=columns)
        tilt, surface_error = evening(
            self.space, weighed.proposal, weighed.unit, weighed.log_p, weighed.log_q
        )
        log_w = weighed.log_w + tilt
        own: dict[str, Array] = {
            "shared/unit": weighed.unit,
            "shared/x": self.space.to_x(weighed.unit),
            "shared/log_p": weighed.log_p,
            "shared/log_q": weighed.log_q,
            "shared/tilt": tilt,
            "shared/log_w": log_w - log_sum_exp(log_w),
        }
        own |= {f"column/{b}": column for b, column in weighed.columns.items()}
        count = self.per_node(len(weighed.unit), self.rotor.particles)
        stays: set[str] = set()
        if previous is not None and self.fits(previous):
            size = previous.meta["particles"]
            if size == count * len(log_w) and previous.meta["placement"] == weighed.key.hex():
                stays = self.unread(previous) - set(previous.meta["provisional"])
                stays -= self.otherwise_known(previous, weighed)
        kept = {f"blade/{b}/{part}" for b in stays for part in ("local", "log_w")}
        due = [b for b in self.rotor.blades if b not in stays]
        own |= self.drawn(due, Nodes(weighed.unit, weighed.key, count), weighed.columns)
        below = previous.arrays if previous is not None else Arrays.EMPTY
        arrays = below.over(own, kept)
        best = weighed.unit[[int(np.argmax(weighed.log_p))]]
        bad = blamed(self.messages, self.settled[1], best)
        start = self.start
        told = start.told if start is not None else self.looking.at(*self.settled).told()
        return self.state(
            own,
            arrays,
            weighed.key,
            log_w,
            self.message_error(weighed.unit),
            bad,
            told,
            self.few_draws(own, previous, stays),
            sealed=True,
            thin=set(),
            surface=surface_error,
        )

    def exchanged(self) -> list[dict[str, Any]]:
        """Blades whose readings of a visit look exchanged (`exchanged`)."""
        return self.looking.at(*self.settled).exchanged

    @cached_property
    def looking(self) -> Looking:
        """The looks at all visits (`looked`)."""

        def messages_of(readings: Mapping[str, Sequence[Inspection]]) -> dict[str, BladeMessage]:
            rows = {b: self.work.rows_of(self.model, own) for b, own in readings.items()}
            return self.work.messages_of(self.model, rows, self.space, self.rotor.known or {})

        return Looking(self.messages, messages_of, self.work.looks)

    def otherwise_known(self, previous: RotorState, weighed: Weighed) -> set[str]:
        """Blades whose column was a table's before and no longer is, or the other way round.

        Their draws, which the column weighs, are drawn anew: whether there are enough blades alike
        (`alike`) changes with other blades' readings. Only those read once can be among them.
        """
        unread = self.unread(previous)
        once = [b for b, m in self.messages.items() if b in unread and family_key(m) is not None]
        old = previous.arrays
        return {b for b in once if not np.array_equal(old[f"column/{b}"], weighed.columns[b])}

    def drawn(
        self, blades: Sequence[str], nodes: Nodes, columns: Mapping[str, Array]
    ) -> dict[str, Array]:
        """The particle sets of these blades at these nodes."""
        return self.work.sets.of(
            self.model, self.rotor, self.space, self.messages, blades, nodes, columns
        )

    def few_draws(
        self, own: Mapping[str, Array], previous: RotorState | None, kept: set[str]
    ) -> list[dict[str, Any]]:
        """Blades of whose draws too few count (`few`), where those kept are the state's before."""
        before = [] if previous is None else previous.meta["health"].get("few_draws", [])
        return few_draws(self.rotor.blades, own, before, kept)

    def message_error(self, unit: Array, previous: RotorState | None = None) -> tuple[float, float]:
        """Root mean square errors [nat] over all blades' messages: of log p at the nodes, and of
        its differences between nodes.

        The unread blades' share is that of the state before, where one is given.
        """
        unread = set() if previous is None else self.unread(previous) & set(self.messages)
        own = [m.error(unit) for b, m in self.messages.items() if b not in unread]
        square = np.sum(np.reshape(own, (-1, 2)) ** 2, axis=0)
        if previous is not None:
            square += len(own) * NEARLY**2
        if previous is not None and unread:
            health, share = previous.meta["health"], len(unread) / len(previous.meta["readings"])
            before = np.array([health["message_error_nat"], health["message_tilt_nat"]])
            square += before**2 * share
        total, tilt = np.sqrt(square)
        return float(total), float(tilt)

    def state(
        self,
        own: Mapping[str, Array],
        arrays: Arrays,
        key: bytes,
        log_w: Array,
        message_error: tuple[float, float],
        contradicted: Sequence[Mapping[str, Any]],
        told: Told,
        few: Sequence[Mapping[str, Any]],
        *,
        sealed: bool,
        thin: set[str],
        tempered: float = 1.0,
        untempered: Array | None = None,
        surface: float | None = None,
    ) -> RotorState:
        """The value with its description; of tempered weights the evidence is of those before."""
        for value in own.values():
            value.flags.writeable = False
        nodes = len(log_w)
        carried = health(log_w, *message_error)
        carried |= {"tempered": round(tempered, 4)}
        if surface is not None:
            carried |= {"surface_error_nat": round(surface, 4)}
        if self.prior is not None:
            carried |= {"prior_error_nat": round(self.prior["error_nat"], 4)}
        whole = log_w if untempered is None else untempered
        meta: dict[str, Any] = {
            "algorithm_version": ALGORITHM,
            "model": self.model.digest,
            "rotor": self.rotor.id,
            "seed": self.rotor.seed,
            "particles": self.per_node(nodes, self.rotor.particles) * nodes,
            "sealed": sealed,
            "provisional": sorted(thin),
            "events_digest": self.events_digest,
            "events": self.events,
            "readings": self.readings,
            "placement": key.hex(),
            "shared": list(self.space.names),
            "local": [p.name for p in locals_of(self.model)],
            "blades": list(self.rotor.blades),
            "log_evidence": log_sum_exp(whole) - float(np.log(nodes)),
            "health": verdict(carried, contradicted, told, few, sealed=sealed),
            "arrays": sorted(arrays),
        }
        if self.prior is not None:
            meta["prior"] = self.prior
        if (half_life := self.model.network.forgetting_h) is not None:
            left = {b: round(m.rows.effective, 4) for b, m in self.messages.items()}
            meta["forgetting"] = {"half_life_h": half_life, "effective_readings": left}
        return RotorState(meta, arrays, frozenset(own))
