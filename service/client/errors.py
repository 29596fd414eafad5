"""What a call ends with when it does not end well."""

from __future__ import annotations

import re
from typing import Any

import httpx

from core.errors import BladetwinError

Json = dict[str, Any]


class ProblemError(BladetwinError):
    """The service refused: `status`, `problem` (RFC 9457) and its `faults` say why."""

    def __init__(self, response: httpx.Response) -> None:
        self.status = response.status_code
        try:
            told = response.json()
        except ValueError:
            told = None
        self.problem: Json = told if isinstance(told, dict) else {"detail": _foreign(response)}
        if response.is_redirect:
            there = response.headers.get("location", "elsewhere")
            self.problem = {"detail": f"sent on to {there}. To mend it: give that address."}
        self.faults: list[Json] = self.problem.get("faults", [])
        detail = self.problem.get("detail", "")
        request = response.request
        super().__init__(f"{request.method} {request.url.path}: {self.status}: {detail}")


def _foreign(response: httpx.Response) -> str:
    """What a proxy, or another program, answers in the service's place, as one line."""
    said = response.text
    if "html" in response.headers.get("content-type", ""):
        said = re.sub(r"<(style|script)\b.*?</\1>|<[^>]*>", " ", said, flags=re.DOTALL | re.I)
    said = " ".join(said.split())[:200] or "nothing"
    return (
        f"no answer of bladetwin's: {said}. To mend it: see that the service runs and is what "
        "answers at this address."
    )


class BlockedError(BladetwinError):
    """The rotor is blocked; `rotor` is its answer with the error and the event named."""

    def __init__(self, rotor: Json) -> None:
        self.rotor = rotor
        super().__init__(f"rotor {rotor['id']} is blocked: {rotor['last_error']}")


class MissingError(BladetwinError):
    """A package that a helper needs is not installed here; `package` names it."""

    def __init__(self, package: str, extra: str) -> None:
        self.package = package
        super().__init__(
            f"{package} is not installed here. To mend it: pip install 'bladetwin[{extra}]'."
        )
