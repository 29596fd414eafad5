"""Which version a read asks for: `version=N`, or `at=` a calendar moment."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends, Query

from service.api.problems import RequestError, fault
from service.moments import OutsideError, seconds_of
from service.ports import Which

Version = Annotated[int | None, Query(ge=1, lt=2**62, description="a version that is kept")]
At = Annotated[
    str | None,
    Query(max_length=40, description="a moment, e.g. 2031-05-04T10:00:00Z: as it was known then"),
]


async def which_of(version: Version = None, at: At = None) -> Which:
    """The version asked for; 422 for a moment that is none, or for both."""
    if at is None:
        return Which(version)
    if version is not None:
        raise refuse(at, "is given beside `version`", "give one of the two")
    try:
        return Which(at=seconds_of(at))
    except OutsideError as error:
        raise refuse(at, str(error), "ask for a moment of the rotor, or leave it out") from None
    except (ValueError, OverflowError):
        remedy = "write it with its offset, e.g. 2031-05-04T10:00:00Z (a plus sign as %2B)"
        raise refuse(at, "is no moment", remedy) from None


def refuse(at: str | None, problem: str, remedy: str) -> RequestError:
    detail = f"at = {at!r} {problem}. To mend it: {remedy}"
    return RequestError(422, "invalid-input", detail, [fault("at", at, problem, remedy)])


Asked = Annotated[Which, Depends(which_of)]
