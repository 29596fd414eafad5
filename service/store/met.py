"""What a process has read of models and rotors and what does not change.

A version of a model never does; a rotor stays with the version that it was created with, and its
blades are only ever added. So a reading of a blade that was met is checked by what is known here,
and the statement that appends it holds that against the database (`service.store.single`), which
may be another one than the process began with.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable

from service.ports import ModelCard

MOST_CARDS = 64
MOST_ROTORS = 1024
Key = tuple[str, str]


class Met:
    """Cards by id and version, and of rotors their model and the blades that were asked for."""

    def __init__(self) -> None:
        self._cards: dict[Key, ModelCard] = {}
        self._rotors: OrderedDict[str, tuple[Key, frozenset[str]]] = OrderedDict()

    def card(self, model_id: str, version: str) -> ModelCard | None:
        return self._cards.get((model_id, version))

    def put_card(self, card: ModelCard) -> None:
        if len(self._cards) >= MOST_CARDS:
            self._cards = {}
        self._cards[card.id, card.version] = card

    def put_blades(self, rotor_id: str, card: ModelCard, blades: Iterable[str]) -> None:
        """These are blades of the rotor. (Of two threads that add at once one may be forgotten.)"""
        key, known = self._rotors.get(rotor_id, ((card.id, card.version), frozenset[str]()))
        if not known.issuperset(blades):
            self._rotors[rotor_id] = key, known.union(blades)
            if len(self._rotors) > MOST_ROTORS:
                self._rotors.popitem(last=False)

    def card_of(self, rotor_id: str, blade: str) -> ModelCard | None:
        """The card of a rotor that is known to have this blade."""
        key, blades = self._rotors.get(rotor_id, (None, frozenset[str]()))
        return None if key is None or blade not in blades else self._cards.get(key)
