"""Posterior and prediction, each with everything that it rests on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.adopted import adopted_at
from service.concerned import untold
from service.errors import NotFoundError, NotYetError
from service.handlers.moments import summary
from service.handlers.questions import Question
from service.handlers.rotors import reading, state_of
from service.ports import (
    BladeRecord,
    Get,
    Json,
    ModelCard,
    Prediction,
    RotorRecord,
    Science,
    StateRecord,
    Store,
    Which,
)

UNSTATED: Json = {
    "status": "unknown",
    "reasons": ["the state is of a release that did not say; the next reading computes it anew"],
    "met_floor": None,
    "contradicted": [],
}


def health(state: StateRecord) -> Json:
    """How far a state is to be trusted (`core.calibration.health`); `trusted`: status ok.

    A state of a release that did not say has the status ``unknown``.
    """
    return health_in(state.meta)


def health_in(account: Json) -> Json:
    """The same, of what a version's account says."""
    told: Json = UNSTATED | account["health"]
    return told | {"trusted": told["status"] == "ok"}


@dataclass(frozen=True, slots=True)
class Basis:
    """A version of a rotor's posterior and the model that it rests on; the blade, if named.

    untold  adopted effects that concern this blade, or any, which joined later (`concerned.untold`)
    """

    state: StateRecord
    card: ModelCard
    blade: BladeRecord | None
    untold: tuple[str, ...] = ()

    def arrays(self, store: Store) -> Get:
        """The version's arrays, for what computes on them outside of a transaction."""
        return store.arrays(self.state.rotor_id, self.state.version)

    def to_json(self) -> Json:
        state = self.state
        return {
            "rotor": state.rotor_id,
            "version": state.version,
            "through_seq": state.through_seq,
            "events_digest": state.events_digest,
            "state_digest": state.digest,
            "sealed": state.sealed,
            "model": self.card.id,
            "model_version": self.card.version,
            "model_digest": self.card.digest,
            "algorithm_version": state.algorithm_version,
            "untold": list(self.untold),
        }


def basis(
    store: Store, science: Science, rotor_id: str, which: Which, blade: str | None = None
) -> Basis:
    """The version asked for; the blade, if named, must exist in it.

    DamagedRotorError: the rotor, or a blade of it, is not what was written.
    """
    with reading(store, rotor_id, which) as tx:
        seen = tx.seen_with(rotor_id, blade)
        seen.check()
        rotor, found = seen.rotor, seen.blades[0] if seen.blades else None
        if blade is not None and found is None:
            raise NotFoundError("blade", blade, f"GET /v1/rotors/{rotor_id} lists the blades")
        state = seen.state() if which.newest else state_of(tx, rotor_id, which)
        card = tx.records.model(rotor.model_id, state.model_version)
        adopted = adopted_at(tx, rotor, state.through_seq, seen.changes)
        blades = [found] if found else tx.records.blades(rotor_id) if adopted.sheets else []
    there = [one for one in blades if one.added_seq <= state.through_seq]
    missed = {effect["name"] for effect in adopted.effects if untold(effect, there)}
    if found is not None and found.added_seq > state.through_seq:
        if not which.newest:
            remedy = f"it joined with entry {found.added_seq}: ask for a later version"
            raise NotFoundError(f"blade in version {state.version}", found.id, remedy)
        raise NotYetError(
            f"blade {blade} in version {state.version} of rotor {rotor_id}",
            f"wait for it with GET /v1/rotors/{rotor_id}?wait_for={found.added_seq}&timeout=30",
        )
    return Basis(state, science.vary(card, adopted.network), found, tuple(sorted(missed)))


def newest(store: Store, rotor_id: str) -> tuple[int, str] | None:
    """Number and digest of a rotor's newest version; None: it has none, or there is no rotor."""
    with store.read() as tx:
        return tx.states.newest(rotor_id)


def standing(store: Store, rotor_id: str) -> tuple[RotorRecord, str | None] | None:
    """A rotor's row and the digest of its newest version, from which all that is told of the
    rotor as it stands follows; None: there is no such rotor."""
    with store.read() as tx:
        try:
            return tx.records.standing(rotor_id)
        except NotFoundError:
            return None


def posterior(store: Store, science: Science, found: Basis) -> Json:
    """Mean, sd, quantiles, R, correlations and ESS of the shared or of one blade's parameters."""
    meta = found.state.meta
    with store.read() as tx:
        get = tx.states.reader(found.state)
        if found.blade is None:
            draws = science.shared_draws(meta, get)
        else:
            draws = science.blade_draws(meta, get, found.blade.id)
    return summary(draws) | {"health": health(found.state)}


def bands_of(
    science: Science, found: Basis, get: Get, blade: BladeRecord, asked: Question
) -> Prediction:
    """What a version says of a blade to a question; `get` reads the version's arrays."""
    return science.predict(
        found.card,
        found.state.meta,
        get,
        blade.id,
        asked.quantity,
        asked.times,
        asked.node,
        asked.probability,
        instrument=asked.instrument,
        known=blade.known,
    )


def predict(store: Store, science: Science, found: Basis, asked: Question) -> Json:
    """Bands by source of the blade that the basis names, as plain lists."""
    blade, get = found.blade, found.arrays(store)
    assert blade is not None
    bands = bands_of(science, found, get, blade, asked)
    return {
        "blade": blade.id,
        "quantity": asked.quantity,
        "unit": found.card.outputs[asked.quantity].unit,
        "node": asked.node,
        "probability": asked.probability,
        "instrument": bands.instrument,
        "noise_from": bands.noise_from,
        **{name: np.asarray(getattr(bands, name)).tolist() for name in ("time_h", "mean")},
        "sd": {name: np.asarray(part).tolist() for name, part in bands.sd.items()},
        **{name: np.asarray(getattr(bands, name)).tolist() for name in ("lower", "upper")},
        "quantiles": {str(p): np.asarray(q).tolist() for p, q in bands.quantiles.items()},
        "held_from_h": held_from(science, found, get, blade),
        "health": health(found.state),
    }


def held_from(science: Science, found: Basis, get: Get, blade: BladeRecord) -> float | None:
    """The hour from which a blade has too little of an effect (`Science.held_from`)."""
    return science.held_from(found.card, found.state.meta, get, blade.id, blade.known)
