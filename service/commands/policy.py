"""``bladetwin policy``: what a rotor does by itself, looked at or decided anew, over HTTP."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated

import typer

from service.commands.reach import reached

if TYPE_CHECKING:
    from service.client.answers import Rotor, Standing

ASKS = {
    "never": "asks for no diagnosis by itself",
    "alarm": "asks for a diagnosis where its residuals alarm",
    "readings": "asks for a diagnosis where its residuals alarm and with a quarter more readings",
}
ADOPTS = {"never": "adopts nothing by itself", "effect": "adopts an effect that a diagnosis names"}


def policy(
    rotor: Annotated[str, typer.Argument(help="The rotor.")],
    diagnose: Annotated[
        str | None, typer.Option(help="When it asks for a diagnosis: never, alarm or readings.")
    ] = None,
    adopt: Annotated[
        str | None, typer.Option(help="What it adopts of one by itself: never or effect.")
    ] = None,
    url: Annotated[str, typer.Option(help="The service.")] = "http://127.0.0.1:8000",
    key: Annotated[str | None, typer.Option(help="An API key with read and operate.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Tell what a rotor does by itself, or decide it: what is left out stays as it is."""
    with reached(url, key) as twin:
        now: Rotor | Standing = twin.rotor(rotor)
        if diagnose is not None or adopt is not None:
            now = twin.set_policy(rotor, adopt=adopt, diagnose=diagnose)
    told = {name: now[name] for name in ("id", "diagnose", "adopt", "policy_since")}
    if as_json:
        typer.echo(json.dumps(told))
        return
    since = "its creation" if told["policy_since"] is None else told["policy_since"]
    typer.echo(f"rotor {rotor}, since {since}:")
    typer.echo(f"  {ASKS[now['diagnose']]}")
    typer.echo(f"  {ADOPTS[now['adopt']]}")
