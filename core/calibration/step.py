"""One update at work: messages of all blades at hand, and the ways from them to a state (`online`).

A step knows what it rests on. It is sealed at nodes that follow from the readings alone, or is
provisional at those of the state before; what it takes for both is kept in a `Workspace`.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping, MutableMapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.calibration.alike import family_key
from core.calibration.collapsed import message_of
from core.calibration.columns import Columns
from core.calibration.draws import SHARE
from core.calibration.health import contradictions, verdict
from core.calibration.message import BladeMessage
from core.calibration.rotor import Weighed, weigh
from core.calibration.sets import Nodes, ParticleSets
from core.calibration.smooth import NEARLY
from core.calibration.space import SharedSpace, locals_of, nominal
from core.calibration.start import Start
from core.calibration.state import ALGORITHM, Arrays, RotorSpec, RotorState, health
from core.calibration.surface import evening
from core.calibration.target import BladeRows, assemble
from core.model import Model
from core.observation import Inspection, digest_of
from core.rng import seed_of
from core.smc.particles import log_sum_exp, tempering_exponent
from core.smc.placement import Proposal

Array = NDArray[np.float64]
QUICK_ESS = 0.1  # share of the nodes that must carry the weight, tempered if need be
LEAST_TEMPERING = 0.2  # below this exponent the nodes are placed anew at once
MANY = 4  # touched blades above which nothing is tempered
FIRST = 12  # touched blades that are looked at before all, where there are more
MANY_ESS, FIRST_ESS = 0.2, 0.5  # shares of the nodes that they must leave, or all is placed anew
KEPT = 2000  # blades' rows and messages
PROVISIONAL = 4000  # draws of a touched blade until its rotor is sealed; bands rest on as many


class Workspace:
    """What is kept between updates of one process; dropping it changes no result.

    places  where nodes were found to stand, as JSON by what that follows from: a calibration that
            is asked for again, by another process perhaps, searches nothing. None: not kept
    """

    def __init__(self, places: MutableMapping[str, Any] | None = None) -> None:
        self.places = places
        self.columns = Columns()
        self.rows: OrderedDict[tuple[str, str], BladeRows] = OrderedDict()
        self.messages: OrderedDict[tuple[Any, ...], BladeMessage] = OrderedDict()
        self.sets = ParticleSets()

    def rows_of(self, model: Model, readings: Sequence[Inspection]) -> BladeRows:
        key = (model.digest, digest_of(readings))
        if key not in self.rows:
            made = assemble(model, readings)
            assert made is not None
            self.rows[key] = made
            while len(self.rows) > KEPT:
                self.rows.popitem(last=False)
        return self.rows[key]

    def messages_of(
        self,
        model: Model,
        rows: Mapping[str, BladeRows],
        space: SharedSpace,
        known: Mapping[str, Mapping[str, float]],
    ) -> dict[str, BladeMessage]:
        """The blades' messages; those of before, with what they have made of their rows."""
        found = dict[str, BladeMessage]()
        for blade, own in rows.items():
            fixed = nominal(model, own.response.names, known.get(blade))
            if space.joint is not None:  # a prior from elsewhere is no part of the key
                found[blade] = message_of(model, own, space, fixed)
                continue
            told = (space.names, space.priors, space.tails, space.heavy)
            key = (model.digest, own.digest, tuple(sorted(fixed.items())), told)
            if key not in self.messages:
                self.messages[key] = message_of(model, own, space, fixed)
            self.messages.move_to_end(key)
            found[blade] = self.messages[key]
        while len(self.messages) > KEPT:
            self.messages.popitem(last=False)
        return found


def tempering(log_w: Array, share: float = QUICK_ESS) -> float:
    """The exponent in [0, 1] that leaves a share of the nodes effective; NaN stays NaN."""
    if np.isnan(log_w).any():
        return float("nan")
    return tempering_exponent(log_w, share * len(log_w))


@dataclass(frozen=True)
class Step:
    """One update at work: what it rests on, and the two ways to a state.

    start  where the posterior is expected, if it is (`start`)
    """

    model: Model
    rotor: RotorSpec
    space: SharedSpace
    messages: Mapping[str, BladeMessage]
    work: Workspace
    events_digest: str
    events: int
    start: Start | None = None

    @property
    def prior(self) -> dict[str, Any] | None:
        """The stored posterior that is the prior, if one is."""
        joint = self.space.joint
        return dict(joint.summary) if joint is not None else None

    @cached_property
    def readings(self) -> dict[str, str]:
        return {b: m.digest for b, m in self.messages.items()}

    def per_node(self, nodes: int, particles: int) -> int:
        """Draws at each node: whole groups, so that every stratum counts alike."""
        return SHARE * -(-particles // (nodes * SHARE))

    def unread(self, previous: RotorState) -> set[str]:
        """Blades whose readings are those of the state before."""
        before: Mapping[str, str] = previous.meta["readings"]
        blades = set(self.rotor.blades)
        return {
            b for b in previous.meta["blades"]
            if b in blades and before.get(b) == self.readings.get(b)
        }  # fmt: skip

    def fits(self, previous: RotorState) -> bool:
        """True where the state before speaks of the same rotor, model and shared parameters."""
        same = {"model": self.model.digest, "rotor": self.rotor.id, "seed": self.rotor.seed}
        same |= {"shared": list(self.space.names), "local": [p.name for p in locals_of(self.model)]}
        same |= {"prior": self.prior}
        return all(previous.meta.get(name) == value for name, value in same.items())

    def told_by(self, previous: RotorState) -> bool:
        """True where the state before is sealed and rests on the same readings: it is this one."""
        same = {"sealed": True, "events_digest": self.events_digest, "events": self.events}
        same |= {"readings": self.readings, "blades": list(self.rotor.blades)}
        nodes = len(previous.arrays["shared/unit"])
        same |= {"particles": self.per_node(nodes, self.rotor.particles) * nodes}
        return self.fits(previous) and all(previous.meta.get(k) == v for k, v in same.items())

    def reweighted(self, previous: RotorState) -> tuple[Array, dict[str, Array]] | None:
        """log p at the nodes of the state before, and the touched blades' columns.

        log p moves by the difference of these columns: no other blade is looked at. None where
        the shared parameters are others now, or too few nodes would carry the weight; where many
        blades are touched nothing is tempered, and a few of them are looked at before all.
        """
        if not self.fits(previous):
            return None
        old, unread = previous.arrays, self.unread(previous)
        unit = old["shared/unit"]
        touched = [b for b in sorted(self.messages) if b not in unread]
        before = [b for b in sorted(previous.meta["readings"]) if b not in unread]
        many = len(touched) > MANY
        looks = [(MANY_ESS if many else QUICK_ESS, touched, before)]
        if len(touched) > FIRST:
            few = sorted(touched, key=lambda blade: seed_of(0, blade))[:FIRST]
            looks.insert(0, (FIRST_ESS, few, [b for b in before if b in few]))
        for share, blades, replaced in looks:
            log_p = old["shared/log_p"].copy()
            for blade in replaced:
                log_p -= old[f"column/{blade}"]
            columns = self.work.columns.all({b: self.messages[b] for b in blades}, unit, "near")
            log_p += sum(columns.values(), np.zeros(len(unit)))
            beta = tempering(log_p - old["shared/log_q"] + old["shared/tilt"], share)
            if not beta >= (1.0 if many else LEAST_TEMPERING):  # or not a number
                return None
        return log_p, columns

    def provisional(
        self, previous: RotorState, found: tuple[Array, dict[str, Array]]
    ) -> RotorState:
        """The state on the nodes of the one before, which keep their tilt (`surface`).

        Touched blades get fewer draws for now.
        """
        (log_p, columns), old, unread = found, previous.arrays, self.unread(previous)
        log_w = log_p - old["shared/log_q"] + old["shared/tilt"]
        beta = tempering(log_w)
        log_w = beta * log_w
        unit, key = old["shared/unit"], bytes.fromhex(previous.meta["placement"])
        own = {"shared/log_p": log_p, "shared/log_w": log_w - log_sum_exp(log_w)}
        kept = {"shared/unit", "shared/x", "shared/log_q", "shared/tilt"}
        count = self.per_node(len(unit), min(self.rotor.particles, PROVISIONAL))
        due = [b for b in self.rotor.blades if b not in unread]
        thin = {b for b in previous.meta["provisional"] if b in unread} | set(due)
        for blade in self.rotor.blades:
            if blade in unread:
                kept |= {f"blade/{blade}/local", f"blade/{blade}/log_w"}
                if blade in self.messages:
                    kept.add(f"column/{blade}")
        own |= self.drawn(due, Nodes(unit, key, count), columns)
        arrays = old.over(own, kept)
        bad = contradictions(self.messages, columns, unit, log_p)
        before = previous.meta["health"].get("contradicted", [])
        bad += [one for one in before if one["blade"] in unread]
        error = self.message_error(unit, previous)
        return self.state(
            own, arrays, key, log_w, error, bad, sealed=False, thin=thin, tempered=beta
        )

    @cached_property
    def weighed(self) -> Weighed:
        """The shared nodes with their weights."""
        seed, places = seed_of(self.rotor.seed, self.rotor.id, "nodes") % 2**63, self.work.places
        if places is None:
            return weigh(self.space, self.messages, self.work.columns, seed, start=self.start)
        told = places.get(key := self.question)
        placed = None if told is None else Proposal.of(told)
        made = weigh(
            self.space, self.messages, self.work.columns, seed, start=self.start, placed=placed
        )
        places[key] = made.proposal.told()
        return made

    @cached_property
    def question(self) -> str:
        """Digest of all that the nodes' places follow from: readings, model, seed and start."""
        start = self.start
        told = [(b, self.messages[b].name) for b in sorted(self.messages)]
        same = (ALGORITHM, self.rotor.id, self.rotor.seed, self.space.names, told, self.prior)
        parts = [repr(same)]
        if start is not None:
            parts += [
                repr(start.names),
                start.mean.tobytes().hex(),
                start.covariance.tobytes().hex(),
            ]
        return sha256("\n".join(parts).encode()).hexdigest()

    @property
    def log_evidence(self) -> float:
        """By the nodes' weights, which a tilt leaves as they are."""
        log_w = self.weighed.log_w
        return log_sum_exp(log_w) - float(np.log(len(log_w)))

    def sealed(self, previous: RotorState | None = None) -> RotorState:
        """The state as a function of the readings alone; equal draws are taken from the last."""
        weighed = self.weighed
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
        bad = contradictions(self.messages, weighed.columns, weighed.unit, weighed.log_p)
        return self.state(
            own,
            arrays,
            weighed.key,
            log_w,
            self.message_error(weighed.unit),
            bad,
            sealed=True,
            thin=set(),
            surface=surface_error,
        )

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
        *,
        sealed: bool,
        thin: set[str],
        tempered: float = 1.0,
        surface: float | None = None,
    ) -> RotorState:
        """The value with its description."""
        for value in own.values():
            value.flags.writeable = False
        nodes = len(log_w)
        carried = health(log_w, *message_error)
        carried |= {"tempered": round(tempered, 4)}
        if surface is not None:
            carried |= {"surface_error_nat": round(surface, 4)}
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
            "log_evidence": log_sum_exp(log_w) - float(np.log(nodes)),
            "health": verdict(carried, contradicted, sealed=sealed),
            "arrays": sorted(arrays),
        }
        if self.prior is not None:
            meta["prior"] = self.prior
        if (half_life := self.model.network.forgetting_h) is not None:
            left = {b: round(m.rows.effective, 4) for b, m in self.messages.items()}
            meta["forgetting"] = {"half_life_h": half_life, "effective_readings": left}
        return RotorState(meta, arrays, frozenset(own))
