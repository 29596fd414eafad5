"""What rotors, blades, policies and entries of the log are called by: SHA-256 of their content."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import fields, replace
from hashlib import sha256

from service.ports import Adopt, BladeRecord, Diagnose, Json, RotorRecord

FIELDS = tuple(field.name for field in fields(BladeRecord))


def digest_of_json(data: object) -> tuple[str, str]:
    """A body as canonical JSON, and its SHA-256."""
    text = json.dumps(data, sort_keys=True, separators=(",", ":"))
    return text, sha256(text.encode()).hexdigest()


def told_of(blade: BladeRecord) -> Json:
    """A blade as its digest sees it, which knows no field that it does not use.

    Of -0.0 SQLite keeps 0.0.
    """
    told = {name: getattr(blade, name) for name in FIELDS}
    if blade.time_h0 is not None:
        told["time_h0"] = blade.time_h0 + 0.0
    if blade.known is None:
        del told["known"]
    return told


def digest_of_blade(blade: BladeRecord) -> str:
    """That of its entry of the log, where it joined later."""
    return digest_of_json(told_of(replace(blade, added_seq=0, retired_seq=None)))[1]


def as_created(blades: Sequence[BladeRecord]) -> list[BladeRecord]:
    """Those of a rotor's creation, as they were then; `blades` by id."""
    first = [blade for blade in blades if blade.added_seq == 0]
    return [b if b.retired_seq is None else replace(b, retired_seq=None) for b in first]


def digest_of_policy(rotor_id: str, adopt: str, diagnose: str, at: float) -> str:
    """What a rotor does by itself, since when."""
    return digest_of_json(["policy", rotor_id, adopt, diagnose, at])[1]


def policy_problem(rotor: RotorRecord) -> str | None:
    """Why the policy in force is not the one that was written; None: it is, or there is none."""
    if (now := rotor.policy) is None:
        return None
    made = digest_of_policy(rotor.id, now.adopt, now.diagnose, now.at)
    if made == now.digest:
        return None
    written = str(now.digest)[:12]
    what = f"what it does by itself has digest {made[:12]}…, written was {written}…"
    return f"{what} (POST …/policy with both options writes it anew)"


def digest_of_rotor(
    rotor_id: str,
    model_id: str,
    blades: Sequence[BladeRecord],
    particles: int,
    seed: int,
    network: Json | None,
    adopt: Adopt = "never",
    diagnose: Diagnose = "never",
) -> str:
    """What tells a repeated creation from another one; `blades` as at the creation, by id.

    What a rotor leaves as it is stands in no digest if nothing after it does.
    """
    body = [rotor_id, model_id, [told_of(b) for b in blades], particles, seed]
    told: list[object] = [network, adopt, diagnose]
    for plain in ("never", "never", None):
        if told[-1] != plain:
            break
        del told[-1]
    return digest_of_json([*body, *told])[1]
