"""What a field may be called where a body has one that nobody knows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from difflib import get_close_matches
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel

OUT = "leave the field out, or correct its name"
MOST = 20  # names told


def remedy(kind: Any, loc: Sequence[str | int]) -> str:
    """What to do about the unknown field at `loc` of a body of this type: the name that was meant,
    and those that there are.

    >>> from service.api.rotor_bodies import RotorIn
    >>> remedy(RotorIn, ["blades", 3, "lots"])[:58]
    "leave the field out, or correct its name: 'lot' was meant?"
    >>> remedy(RotorIn, ["id", "lots"])  # of nothing that has fields
    'leave the field out, or correct its name'
    """
    names = _names(kind, loc)
    if not names:
        return OUT
    near = get_close_matches(str(loc[-1]), names, n=1)
    meant = f"{near[0]!r} was meant? It is" if near else "it is"
    shown = ", ".join(names[:MOST]) + (" …" if len(names) > MOST else "")
    return f"{OUT}: {meant} one of {shown}"


def _names(kind: Any, loc: Sequence[str | int]) -> list[str]:
    """Of the fields that an object may have which holds what stands at `loc`."""
    kinds = list(_plain(kind))
    for part in loc[:-1]:
        kinds = [own for one in kinds for inside in _within(one, part) for own in _plain(inside)]
    models = (one for one in kinds if isinstance(one, type) and issubclass(one, BaseModel))
    names = (field.alias or name for one in models for name, field in one.model_fields.items())
    return list(dict.fromkeys(names))


def _plain(kind: Any) -> Iterator[Any]:
    """The types that one is made of: without notes, a union's one by one."""
    if get_origin(kind) is Annotated:
        yield from _plain(get_args(kind)[0])
    elif get_origin(kind) in (Union, UnionType):
        for one in get_args(kind):
            yield from _plain(one)
    else:
        yield kind


def _within(kind: Any, part: str | int) -> Iterator[Any]:
    """What stands at one step into a type; a step that names the member of a union stays there."""
    origin, inside = get_origin(kind), get_args(kind)
    if isinstance(part, int):
        if inside and isinstance(origin, type) and issubclass(origin, Sequence):
            yield inside[0]
    elif inside and isinstance(origin, type) and issubclass(origin, Mapping):
        yield inside[1]
    elif isinstance(kind, type) and issubclass(kind, BaseModel):
        if part == kind.__name__:
            yield kind
        for name, field in kind.model_fields.items():
            if part == (field.alias or name):
                yield field.annotation
