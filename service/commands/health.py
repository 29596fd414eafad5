"""`bladetwin health`: whether the service is ready, for a container's health check."""

from __future__ import annotations

import json
import urllib.error
import urllib.request
from typing import Annotated, Any

import typer

from service.commands import Json, say
from service.settings import Settings

EVERY = {"0.0.0.0": "127.0.0.1", "::": "[::1]", "": "127.0.0.1"}


def health(
    url: Annotated[
        str | None, typer.Option(help="Of the service; default: by BLADETWIN_HOST and _PORT.")
    ] = None,
    timeout: Annotated[float, typer.Option(help="Longest wait for the answer, s.")] = 4.0,
    as_json: Json = False,
) -> None:
    """Ask a service whether it is ready. Exit status: 0 ready, 1 not.

    Ready: it answers, its database does, and its schema is one that it may run on (GET /readyz).
    """
    base = url or address(Settings.load())
    told = _asked(f"{base.rstrip('/')}/readyz", timeout)
    ready = told["status"] == 200 and not told["detail"]
    say(
        told | {"ready": ready},
        [f"{base}: {'ready' if ready else told['detail']}"],
        as_json=as_json,
    )
    if not ready:
        raise typer.Exit(1)


def address(settings: Settings) -> str:
    """Where a program of this machine reaches the service.

    >>> address(Settings(host="0.0.0.0", port=8123))
    'http://127.0.0.1:8123'
    """
    host = settings.host
    plain = f"[{host}]" if ":" in host else host
    return f"http://{EVERY.get(host, plain)}:{settings.port}"


def _asked(url: str, timeout: float) -> dict[str, Any]:
    try:
        # no proxy: the address is this machine's, or was given as it is
        opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
        with opener.open(url, timeout=timeout) as answer:
            return {"status": answer.status, "detail": _other(answer.read(100_000))}
    except urllib.error.HTTPError as error:
        with error:
            return {"status": error.code, "detail": _detail(error.read(100_000))}
    except (OSError, ValueError) as error:
        return {"status": None, "detail": f"no answer: {error}"}


def _other(body: bytes) -> str:
    """Why what answered with 200 is no service of ours that is ready: a proxy's page, say."""
    try:
        if json.loads(body)["ready"] is True:
            return ""
    except (ValueError, KeyError, TypeError):
        pass
    return "what answers there is not bladetwin. To mend it: give its --url, or start it"


def _detail(body: bytes) -> str:
    """Why a service is not ready, by what its /readyz says."""
    try:
        told = json.loads(body)
        return str(told.get("remedy") or f"its database does not answer ({told['database']})")
    except (ValueError, KeyError, TypeError, AttributeError):
        return "it is not ready"
