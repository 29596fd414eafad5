"""What updates of one process keep between them: rows, messages, columns, particle sets.

Which kind of message a blade's rows get is told here as well (`message_of`).
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Mapping, MutableMapping, Sequence
from typing import Any

from core.calibration.collapsed import CollapsedMessage
from core.calibration.columns import KeptColumns
from core.calibration.direct import DirectMessage
from core.calibration.exchanged import Kept
from core.calibration.message import BladeMessage
from core.calibration.sets import ParticleSets
from core.calibration.space import SharedSpace, locals_of, nominal
from core.calibration.target import BladeRows, assemble
from core.model import Model
from core.observation import Inspection
from core.readings import digest_of
from core.surrogate.closed_form import FormulaRows

KEPT = 2000  # blades' rows and messages
MANY = 4  # local parameters from which particles take the quadrature's place


def message_of(
    model: Model, rows: BladeRows, space: SharedSpace, fixed: dict[str, float]
) -> BladeMessage:
    """The message of these rows: by quadrature up to three local parameters, else by particles;
    of a closed form, from the formula itself.
    """
    if isinstance(rows.response, FormulaRows):
        return DirectMessage(model, rows, space, fixed)
    many = len(locals_of(model, rows.response.names)) >= MANY
    kind = CollapsedMessage if many else BladeMessage
    return kind(model, rows, space, fixed)


class Workspace:
    """What is kept between updates of one process; dropping it changes no result.

    places  where nodes were found to stand, as JSON by what that follows from: a calibration that
            is asked for again, by another process perhaps, searches nothing. None: not kept
    heed    called every few seconds of work: it may raise, and ends an update that nobody wants
    """

    def __init__(
        self,
        places: MutableMapping[str, Any] | None = None,
        heed: Callable[[], None] = lambda: None,
    ) -> None:
        self.places, self.heed = places, heed
        self.columns = KeptColumns(heed=heed)
        self.rows: OrderedDict[tuple[str, str], BladeRows] = OrderedDict()
        self.messages: OrderedDict[tuple[Any, ...], BladeMessage] = OrderedDict()
        self.sets = ParticleSets()
        self.looks: Kept = OrderedDict()

    def rows_of(self, model: Model, readings: Sequence[Inspection]) -> BladeRows:
        key = (model.digest, digest_of(readings))
        if key not in self.rows:
            made = assemble(model, [reading.apart() for reading in readings])
            assert made is not None
            self.rows[key] = made
            while len(self.rows) > KEPT:
                self.rows.popitem(last=False)
        return self.rows[key]

    def messages_of(
        self,
        model: Model,
        rows: Mapping[str, BladeRows],
        space: SharedSpace,
        known: Mapping[str, Mapping[str, float]],
    ) -> dict[str, BladeMessage]:
        """The blades' messages; those of before, with what they have made of their rows."""
        found = dict[str, BladeMessage]()
        for blade, own in rows.items():
            fixed = nominal(model, own.response.names, known.get(blade))
            if space.joint is not None:  # a prior from elsewhere is no part of the key
                found[blade] = message_of(model, own, space, fixed)
                continue
            told = (space.names, space.priors, space.tails, space.heavy)
            key = (model.digest, own.digest, tuple(sorted(fixed.items())), told)
            if key not in self.messages:
                self.messages[key] = message_of(model, own, space, fixed)
            self.messages.move_to_end(key)
            found[blade] = self.messages[key]
        while len(self.messages) > KEPT:
            self.messages.popitem(last=False)
        return found
