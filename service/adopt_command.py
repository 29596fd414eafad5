"""``bladetwin adopt``: what a diagnosis named, into a rotor's model or out of it, over HTTP."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any

import typer

from core.errors import InputError
from service.commands.reach import reached
from service.diagnose_command import amplitude

if TYPE_CHECKING:
    from service.client import Client

NOT_FOUND = 404
SHOWN = 5  # readings named


def adopt(
    rotor: Annotated[str, typer.Argument(help="The rotor.")],
    diagnosis: Annotated[str, typer.Argument(help="The diagnosis, by its id.")],
    alternative: Annotated[
        int | None, typer.Option(help="Adopt this one of its alternatives, by its number.")
    ] = None,
    because: Annotated[
        str | None, typer.Option(help="From where it is known that it is this one.")
    ] = None,
    out: Annotated[
        bool, typer.Option("--back-out", help="Bring the network before the adoption back.")
    ] = False,
    wait: Annotated[
        float, typer.Option(help="Wait so many seconds for the sealed posterior; 0: do not.")
    ] = 0.0,
    url: Annotated[str, typer.Option(help="The service.")] = "http://127.0.0.1:8000",
    key: Annotated[str | None, typer.Option(help="An API key with read and operate.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Adopt the effect that a diagnosis named, or one of what it could not tell apart, or back it
    out; the posterior follows by itself."""
    if out and (alternative, because) != (None, None):
        remedy = "leave out --alternative and --because"
        raise InputError("--back-out", True, "takes out what was chosen", remedy)
    with reached(url, key) as twin:
        found = {} if as_json else result_of(twin, rotor, diagnosis)
        done = (
            twin.back_out(rotor, diagnosis)
            if out
            else twin.adopt(rotor, diagnosis, alternative=alternative, because=because)
        )
        told: dict[str, Any] = {**done}
        if not as_json:  # it is done, whatever becomes of the waiting
            typer.echo("\n".join(lines_of(rotor, told["adoption"], found)))
            if joined := told.get("joined"):
                typer.echo(f"  joined since, of its lot, and have it, too: {', '.join(joined)}")
        if wait > 0:
            twin.wait_for(rotor, told["head_seq"], wait)
            told["rotor"] = twin.wait_sealed(rotor, wait)
    if as_json:
        typer.echo(json.dumps(told))
    elif "rotor" in told:
        version, digest = told["rotor"]["version"], told["rotor"]["posterior"]["state_digest"]
        typer.echo(f"  sealed as version {version}: {digest[:16]}…")


def result_of(twin: Client, rotor: str, diagnosis: str) -> dict[str, Any]:
    """What a diagnosis found; nothing where it has not ended, or did not travel with its rotor."""
    from service.client import ProblemError

    try:
        found = twin.diagnosis(rotor, diagnosis)["result"]
    except ProblemError as error:
        if error.status != NOT_FOUND:
            raise
        found = None
    return {} if found is None else {**found}


def by_whom(effect: dict[str, Any]) -> str:
    """When an effect was adopted, and that nobody asked for it, or why somebody chose it, as the
    rotor tells it.

    >>> by_whom({"at": "2026-11-30T13:29:02.852Z", "unasked": True})
    'adopted 2026-11-30T13:29Z by the rotor itself'
    >>> by_whom({"chosen": {"alternative": 2, "because": "borescope of outage 4"}})
    'adopted, alternative 2, because: borescope of outage 4'
    >>> by_whom({})  # of a service of an older release
    'adopted'
    """
    when = f" {effect['at'][:16]}Z" if effect.get("at") else ""
    told = f"adopted{when}" + (" by the rotor itself" if effect.get("unasked") else "")
    return f"{told}, {chose(chosen)}" if (chosen := effect.get("chosen")) else told


def chose(chosen: dict[str, Any]) -> str:
    """Which alternative somebody chose, and why."""
    return f"alternative {chosen['alternative']}, because: {chosen['because']}"


def no_longer(effect: dict[str, Any]) -> str | None:
    """Which readings that an effect was found with count no longer; None: all do.

    >>> no_longer({"no_longer": list("abcdefg")})
    '7 of the readings it was found with count no longer (a, b, c, d, e …)'
    >>> no_longer({"no_longer": []}), no_longer({})  # of a service of an older release
    (None, None)
    """
    if not (lost := effect.get("no_longer")):
        return None
    shown = ", ".join(lost[:SHOWN]) + (" …" if len(lost) > SHOWN else "")
    verb = "counts" if len(lost) == 1 else "count"
    return f"{len(lost)} of the readings it was found with {verb} no longer ({shown})"


def lines_of(rotor: str, one: dict[str, Any], found: dict[str, Any]) -> Iterator[str]:
    """What an entry of the log did to the rotor's model; `found`: the diagnosis' result."""
    what = "backed out" if one["what"] == "back-out" else "adopted"
    yield f"rotor {rotor}: {what} with entry {one['seq']}"
    for effect in one["effects"]:
        sized = "amplitude" in effect  # a discrepancy without a cause has none
        yield f"  {effect['name']}: {amplitude(effect, found)}" if sized else f"  {effect['words']}"
    if one.get("chosen"):
        yield f"  {chose(one['chosen'])}"
    if one["readings_since"]:
        yield f"  {one['readings_since']} readings came since the diagnosis"
