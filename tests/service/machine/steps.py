"""Steps of the state machine: how they are marked, and what they are given."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine

from service.api.routers.diagnoses import EXAMPLE
from tests.service.modelled import FIRST, Json

Act = Callable[..., None]
rotors = st.sampled_from(["a", "a", "b"])
campaigns = st.sampled_from(["c1", "c2"])


def act(weight: int = 1, **given: st.SearchStrategy[Any]) -> Callable[[Act], Act]:
    """A step of the machine, how often it is taken beside others, and what it is given."""

    def mark(step: Act) -> Act:
        step.__dict__["given"] = weight * [st.fixed_dictionaries(given)]
        return step

    return mark


def acts(machine: type[RuleBasedStateMachine]) -> st.SearchStrategy[tuple[str, Json]]:
    """Any of its steps. (Rules of Hypothesis are switched off at random, most of them in most
    sequences, which leaves little of a few short ones.)"""
    found = {name: getattr(step, "given", []) for name, step in inspect.getmembers(machine)}
    return st.one_of([st.tuples(st.just(n), one) for n, given in found.items() for one in given])


@dataclass
class Key:
    """An API key, as it was made; `only`: the ids of the rotors that it is for, None: all."""

    id: str
    token: str
    scopes: tuple[str, ...]
    only: tuple[str, ...] | None = None
    revoked: bool = False


def rotor_body(rotor: str, particles: int) -> Json:
    blades = [{"id": b} for b in FIRST]
    fixed = {"model": "rotor-blade", "blades": blades, "seed": 7}
    return {"id": rotor, "particles": particles} | fixed


def asking(campaign: str) -> Json:
    """A diagnosis that looks for a campaign's offset (`naming`)."""
    return {"families": [EXAMPLE["families"][0] | {"name": campaign}]}
