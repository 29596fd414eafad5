"""`bladetwin replay` and `bladetwin verify`: what is stored, against its log and digests."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from core.errors import BladetwinError
from service.commands import DIFFERS, LOST, Json, opened, say
from service.errors import HeldError
from service.settings import Settings

if TYPE_CHECKING:
    from service.ports import Science
    from service.store.audit import Finding
    from service.store.unit_of_work import SqlStore
    from service.worker.rebuild import Repair
    from service.worker.update import Updater

LOOK_AGAIN_S = 0.2
SHOWN = 12
Patience = Annotated[float, typer.Option(help="Wait so long for a worker at work, s.")]


def replay(
    rotor: Annotated[str, typer.Argument(help="Id of the rotor.")],
    mend: Annotated[
        bool, typer.Option("--repair", help="Where it differs, make the newest version again.")
    ] = False,
    patience: Patience = 30.0,
    as_json: Json = False,
) -> None:
    """Compute a rotor's sealed posterior from the log alone and compare it with what is stored.

    Exit status: 0 the same (or mended), 3 different, 1 refused. The newest sealed version is
    compared; without one there is nothing to compare, which is 0.
    """
    from service.worker.rebuild import repair
    from service.worker.replay import replay as compare

    settings = Settings.load()
    with opened(settings, looks=True) as store:
        science, updater = _wired(store, settings)
        told = compare(store, science, rotor)
        done = None
        if mend and told["same"] is False:
            done = _patiently(patience, lambda: repair(updater, rotor, [], renew=True))
            told["repair"] = done.to_json()
    say(told, _replay_lines(told, done), as_json=as_json)
    if told["same"] is False and done is None:
        raise typer.Exit(DIFFERS)


def _replay_lines(told: dict[str, Any], done: Repair | None) -> list[str]:
    made = told["replayed"]
    head = f"rotor {told['rotor']}, through entry {told['through_seq']}, replayed"
    lines = [f"{head}: state {made['state_digest'][:16]}…, readings {made['events_digest'][:16]}…"]
    if told["same"] is None:
        return [*lines, "no sealed version is kept to compare it with"]
    if told["same"]:
        count = len(made["arrays"])
        return [*lines, f"version {told['version']} is the same, in all {count} arrays"]
    for name in ("events_digest", "state_digest"):
        if told["stored"][name] != made[name]:
            lines.append(
                f"{name}: stored {told['stored'][name][:16]}…, replayed {made[name][:16]}…"
            )
    for one in told["differ"][:SHOWN]:
        by = one["largest_difference"]
        lines.append(
            f"array {one['array']} differs" + ("" if by is None else f" by up to {by:.3g}")
        )
    if len(told["differ"]) > SHOWN:
        lines.append(f"and {len(told['differ']) - SHOWN} more arrays")
    if told["stored_algorithm_version"] != told["algorithm_version"]:
        algorithms = (told["stored_algorithm_version"], told["algorithm_version"])
        lines.append("it was computed by algorithm {}, this release has {}".format(*algorithms))
    return lines + _repair_lines(done)


def verify(
    rotor: Annotated[str | None, typer.Argument(help="Id of the rotor; default: all.")] = None,
    mend: Annotated[
        bool, typer.Option("--repair", help="Make damaged versions again from the log.")
    ] = False,
    patience: Patience = 30.0,
    as_json: Json = False,
) -> None:
    """Check what is stored against its digests: log, rotor, blades, versions, arrays, models (of
    one rotor: its own).

    Exit status: 0 sound (or mended), 3 damage that --repair mends, 4 damage that the log cannot
    mend (an entry of the log, a rotor's or a blade's row, a model), 1 refused.
    """
    from service.store.audit import audit
    from service.store.engine import snapshot
    from service.worker.rebuild import repair

    settings = Settings.load()
    with opened(settings, looks=True) as store:
        science, updater = _wired(store, settings)
        rotors = [rotor] if rotor is not None else _rotors(store)
        found = _models(store, science, rotor)
        for name in rotors:
            with snapshot(store.engine) as connection:
                found += audit(connection, name)
        lost = [one for one in found if not one.from_log]
        unsure = {one.rotor for one in lost}
        done = []
        for name in rotors if mend else []:
            own = [one for one in found if one.rotor == name]
            if own and name not in unsure:
                done.append(_patiently(patience, lambda n=name, f=own: repair(updater, n, f)))
        mended = {one.rotor for one in done}
        left = [one for one in found if one.rotor not in mended]
        for name in sorted(mended):  # a repair is believed when nothing is found any more
            with snapshot(store.engine) as connection:
                left += audit(connection, name)
    told = {
        "rotors": len(rotors),
        "findings": [one.to_json() | {"mendable": one.from_log} for one in found],
        "repairs": [one.to_json() for one in done],
        "sound": not left,
    }
    lines = [str(one) for one in found]
    for one in done:
        lines += _repair_lines(one)
    say(told, [*lines, _verdict(len(rotors), left, done)], as_json=as_json)
    if left:
        raise typer.Exit(LOST if lost else DIFFERS)


def _verdict(rotors: int, left: Sequence[Finding], done: Sequence[Repair]) -> str:
    if left:
        return f"{len(left)} damaged part(s) in {rotors} rotor(s)"
    return f"{rotors} rotor(s): " + ("mended" if done else "every digest is as written")


def _repair_lines(done: Repair | None) -> list[str]:
    if done is None:
        return []
    lines = []
    if done.restored:
        versions = ", ".join(map(str, done.restored))
        lines.append(f"rotor {done.rotor}: version(s) {versions} written again from the log")
    if done.dropped:
        versions = ", ".join(map(str, done.dropped))
        lines.append(f"rotor {done.rotor}: version(s) {versions} cannot be made again: dropped")
    if done.version is not None:
        lines.append(f"rotor {done.rotor}: version {done.version} made from the log")
    return lines


def _wired(store: SqlStore, settings: Settings) -> tuple[Science, Updater]:
    from service.bootstrap import make_science, make_worker

    science = make_science(settings, store, kept=True)
    return science, make_worker(store, science, settings).updater


def _rotors(store: SqlStore) -> list[str]:
    from sqlalchemy import select

    from service.store import tables as t

    with store.read() as tx:
        return list(tx.connection.execute(select(t.rotor.c.id).order_by(t.rotor.c.id)).scalars())


def _models(store: SqlStore, science: Science, rotor: str | None = None) -> list[Finding]:
    """What is wrong with the models that are stored; `rotor`: with the one that it runs on."""
    from service.store.audit import audit_artefact, audit_models
    from service.store.engine import snapshot

    with store.read() as tx:
        own = [card for card, source in tx.records.model_sources() if "artefact" in source]
        used = None if rotor is None else tx.records.rotor(rotor)
    if used is not None:
        own = [c for c in own if (c.id, c.version) == (used.model_id, used.model_version)]
    cards: dict[str, Any] = {}
    for name in science.builtins if used is None else {used.model_id} & {*science.builtins}:
        try:
            cards[name] = science.builtin(name)
        except BladetwinError as error:
            cards[name] = error
    with snapshot(store.engine) as connection:
        found = audit_models(connection, cards)
    return found + [one for card in own for one in audit_artefact(store.blob, science, card)]


def _patiently(patience_s: float, work: Any) -> Repair:
    """The repair, once no worker holds the rotor."""
    end = time.monotonic() + patience_s
    while True:
        try:
            done: Repair = work()
        except HeldError:
            if time.monotonic() >= end:
                raise
            time.sleep(LOOK_AGAIN_S)
        else:
            return done
