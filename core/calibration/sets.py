"""Blades' particle sets: weighted draws at the shared nodes, kept by what they rest on.

A set follows from the model, the rotor and its seed, the blade's readings and the nodes. Its random
numbers come from a stream with that name, so that it does not matter when it is drawn, in which
company, or by which process; several are drawn side by side. The column, which a quick step knows
nearly and the sealed one exactly, is not part of the stream's name, but sets are kept by it.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from core.calibration.message import PARTS, POOL, BladeMessage, prior_draws
from core.calibration.space import SharedSpace, locals_of
from core.calibration.state import DRAWS, RotorSpec
from core.digest import array_digest
from core.model import Model
from core.rng import stream

Array = NDArray[np.float64]
Name = tuple[str, ...]
KEPT = 3  # sets for each blade of a rotor, and a hundred


@dataclass(frozen=True, slots=True)
class Nodes:
    """Shared nodes (K, d) of the unit box, the key of their placement, and draws at each."""

    unit: Array
    key: bytes
    per_node: int


@dataclass
class ParticleSets:
    """Sets already drawn: values (K, per_node, L) and log weights (K, per_node); oldest out."""

    kept: OrderedDict[Name, tuple[Array, Array]] = field(default_factory=OrderedDict)

    def of(
        self,
        model: Model,
        rotor: RotorSpec,
        space: SharedSpace,
        messages: Mapping[str, BladeMessage],
        blades: Sequence[str],
        nodes: Nodes,
        columns: Mapping[str, Array],
    ) -> dict[str, Array]:
        """The blades' arrays by name: ``blade/B/local``, ``blade/B/log_w``, ``column/B``.

        columns  log m_b at the nodes (K,) of the blades that were read
        """
        # a blade without a reading is drawn from its prior, wherever the nodes stand
        moved = any(p.population for p in locals_of(model))
        placed, anywhere = nodes.key.hex() + "/".join(space.names), str(len(nodes.unit))

        def named(blade: str) -> Name:
            message, column = messages.get(blade), columns.get(blade)
            reading = "" if message is None else message.digest
            where = placed if message is not None or moved else anywhere
            name = (model.digest, rotor.id, str(rotor.seed), blade, reading, str(nodes.per_node))
            return (*name, where, "" if column is None else array_digest(column))

        names = {b: named(b) for b in blades}
        missing = [b for b in blades if names[b] not in self.kept]
        alone = len(missing) < PARTS

        def drawn(blade: str) -> tuple[Array, Array]:
            rng = stream(rotor.seed, DRAWS, *names[blade][:-1])
            message, column = messages.get(blade), columns.get(blade)
            if message is None or column is None:
                return prior_draws(model, space, nodes.unit, nodes.per_node, rng)
            parts = PARTS if alone else 1
            return message.draws(nodes.unit, nodes.per_node, rng, column, parts)

        made = map(drawn, missing) if alone else POOL.map(drawn, missing)
        self.kept.update(zip((names[b] for b in missing), made, strict=True))
        own = dict[str, Array]()
        for blade in blades:
            self.kept.move_to_end(names[blade])
            own[f"blade/{blade}/local"], own[f"blade/{blade}/log_w"] = self.kept[names[blade]]
            if blade in columns:
                own[f"column/{blade}"] = columns[blade]
        while len(self.kept) > KEPT * len(rotor.blades) + 100:
            self.kept.popitem(last=False)
        return own
