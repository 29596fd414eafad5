"""What an update rests on, and whether a state before it rests on the same.

A sealed state follows from the rotor, the model, the set of readings, the prior and the seed. So
the state before is the answer where all of these are as they were (`Basis.told_by`); where model,
rotor and shared parameters are (`Basis.fits`), it holds what the unread blades need; and the places
of the shared nodes are kept by a digest of all that they follow from (`Basis.question`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from typing import Any

from core.calibration.draws import SHARE
from core.calibration.message import BladeMessage
from core.calibration.space import SharedSpace, locals_of
from core.calibration.start import Start
from core.calibration.state import ALGORITHM, RotorSpec, RotorState
from core.calibration.workspace import Workspace
from core.model import Model


@dataclass(frozen=True)
class Basis:
    """What an update rests on.

    messages       of the blades that were read
    work           what updates keep between them
    events_digest  of the readings; events: how many they are
    start          where the posterior is expected, if it is (`start`)
    """

    model: Model
    rotor: RotorSpec
    space: SharedSpace
    messages: Mapping[str, BladeMessage]
    work: Workspace
    events_digest: str
    events: int
    start: Start | None = None

    @property
    def prior(self) -> dict[str, Any] | None:
        """The stored posterior that is the prior, if one is."""
        joint = self.space.joint
        return dict(joint.summary) if joint is not None else None

    @cached_property
    def readings(self) -> dict[str, str]:
        return {b: m.digest for b, m in self.messages.items()}

    def per_node(self, nodes: int, particles: int) -> int:
        """Draws at each node: whole groups, so that every stratum counts alike."""
        return SHARE * -(-particles // (nodes * SHARE))

    def unread(self, previous: RotorState) -> set[str]:
        """Blades whose readings are those of the state before."""
        before: Mapping[str, str] = previous.meta["readings"]
        blades = set(self.rotor.blades)
        return {
            b for b in previous.meta["blades"]
            if b in blades and before.get(b) == self.readings.get(b)
        }  # fmt: skip

    def fits(self, previous: RotorState) -> bool:
        """True where the state before speaks of the same rotor, model and shared parameters."""
        same = {"model": self.model.digest, "rotor": self.rotor.id, "seed": self.rotor.seed}
        same |= {"shared": list(self.space.names), "local": [p.name for p in locals_of(self.model)]}
        same |= {"prior": self.prior}
        return all(previous.meta.get(name) == value for name, value in same.items())

    def told_by(self, previous: RotorState) -> bool:
        """True where the state before is sealed and rests on the same readings: it is this one."""
        same = {"sealed": True, "events_digest": self.events_digest, "events": self.events}
        same |= {"readings": self.readings, "blades": list(self.rotor.blades)}
        nodes = len(previous.arrays["shared/unit"])
        same |= {"particles": self.per_node(nodes, self.rotor.particles) * nodes}
        return self.fits(previous) and all(previous.meta.get(k) == v for k, v in same.items())

    @cached_property
    def question(self) -> str:
        """Digest of all that the nodes' places follow from: readings, model, seed and start."""
        start = self.start
        told = [(b, self.messages[b].name) for b in sorted(self.messages)]
        same = (ALGORITHM, self.rotor.id, self.rotor.seed, self.space.names, told, self.prior)
        parts = [repr(same)]
        if start is not None:
            parts += [
                repr((start.names, start.alone, start.served)),
                start.mean.tobytes().hex(),
                start.covariance.tobytes().hex(),
                *sorted(start.apart),
            ]
        return sha256("\n".join(parts).encode()).hexdigest()
