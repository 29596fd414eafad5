"""``bladetwin umbridge``: a blade's calibrated model for UM-Bridge clients."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from service.commands import Json, opened, say
from service.settings import Settings


def umbridge(
    rotor: Annotated[str, typer.Argument(help="The rotor.")],
    blade: Annotated[str, typer.Argument(help="The blade.")],
    version: Annotated[
        int | None, typer.Option(help="A version that is kept; default: the newest.")
    ] = None,
    port: Annotated[int, typer.Option(help="Port on 127.0.0.1.")] = 4242,
    as_json: Json = False,
) -> None:
    """Serve a blade's model by the UM-Bridge protocol on 127.0.0.1, until SIGTERM or Ctrl-C.

    Of each quantity the model at given parameters, and its prediction. The version is that of the
    start: what is posted meanwhile changes nothing.
    """
    import uvicorn

    from service.api.server import Protocol
    from service.bootstrap import make_science
    from service.handlers.reads import basis
    from service.ports import Which
    from service.telemetry import configure_logs
    from service.umbridge.app import umbridge_app
    from service.umbridge.models import served

    settings = Settings.load()
    configure_logs(settings.log_level)
    with opened(settings, looks=True) as store:
        science = make_science(settings, store)
        found = basis(store, science, rotor, Which(version), blade)
        models = served(store, science, found)
        facts = {"url": f"http://127.0.0.1:{port}", "models": list(models)} | found.to_json()
        of = f"rotor {rotor}, blade {blade}, version {found.state.version}"
        line = f"UM-Bridge at {facts['url']}: {of}"
        say(facts, [line, *(f"  {name}" for name in models)], as_json=as_json)
        sys.stdout.flush()
        app = umbridge_app(models)
        uvicorn.run(
            app, http=Protocol, host="127.0.0.1", port=port, log_config=None, access_log=False
        )
