"""A rotor and its blades as answers tell them."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from service.api.services import moment
from service.concerned import untold
from service.handlers.reads import health, health_in
from service.handlers.rotors import RotorView
from service.ports import BladeRecord, Json, RotorRecord

BLADE = tuple(field.name for field in fields(BladeRecord))


def rotor_out(rotor: RotorRecord) -> dict[str, Any]:
    blocked = {"error": rotor.last_error, "event": rotor.last_error_event}
    return {
        "id": rotor.id,
        "model": rotor.model_id,
        "model_version": rotor.model_version,
        "particles": rotor.particles,
        "seed": rotor.seed,
        "network": rotor.network,
        "adopt": rotor.adopts,
        "diagnose": rotor.asks,
        "policy_since": None if rotor.policy is None else moment(rotor.policy.at),
        "origin": rotor.origin,
        "created_at": moment(rotor.created_at),
        "head_seq": rotor.head_seq,
        "applied_seq": rotor.applied_seq,
        "version": rotor.version,
        "status": "blocked" if rotor.blocked else "pending" if rotor.dirty else "current",
        "attempts": rotor.attempts,
        "last_error": blocked if rotor.last_error else None,
    }


def listed_out(rotor: RotorRecord, standing: tuple[bool, Json] | None) -> dict[str, Any]:
    sealed, account = (None, None) if standing is None else standing
    return rotor_out(rotor) | {
        "sealed": sealed,
        "health": None if account is None else health_in(account),
    }


def blade_out(blade: BladeRecord) -> dict[str, Any]:
    # (`asdict` would copy deeply: most of the time of an answer with a hundred blades)
    told = {name: getattr(blade, name) for name in BLADE}
    return told | {"retired": blade.retired_seq is not None}


def view_out(view: RotorView) -> dict[str, Any]:
    state = view.state
    posterior = state and {
        "version": state.version,
        "through_seq": state.through_seq,
        "sealed": state.sealed,
        "state_digest": state.digest,
        "events_digest": state.events_digest,
        "model_version": state.model_version,
        "algorithm_version": state.algorithm_version,
        "created_at": moment(state.created_at),
    }
    running = [blade for blade in view.blades if blade.retired_seq is None]
    return rotor_out(view.rotor) | {
        "blades": [blade_out(blade) for blade in view.blades],
        "posterior": posterior,
        "health": state and health(state),
        "network": view.adopted.network,
        "effects": [
            effect
            | {"at": moment(effect["at"]), "untold": untold(effect, running)}
            | {"no_longer": list(view.lost.get(effect["diagnosis"], ()))}
            for effect in view.adopted.effects
        ],
    }
