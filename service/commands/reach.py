"""How commands speak with a service that runs."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from core.errors import BladetwinError

if TYPE_CHECKING:
    from service.client import Client


class AwayError(BladetwinError):
    """The service does not answer."""


@contextmanager
def reached(url: str, key: str | None) -> Iterator[Client]:
    """A client of the service at `url`. AwayError: it does not answer."""
    import httpx

    from service.client import Client

    try:
        with Client(url, key=key) as twin:
            yield twin
    except json.JSONDecodeError:  # of a page that a proxy, or another program, answers with
        raise AwayError(
            f"what answers at {url} is not bladetwin. To mend it: give its --url."
        ) from None
    except httpx.TransportError as error:
        raise AwayError(
            f"{url} does not answer ({error}). To mend it: start `bladetwin serve`, or give --url."
        ) from None
