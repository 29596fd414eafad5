"""The rounds of a refinement: what is planned, what was found, and the log beside the runs."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.archive import Archive
from core.archive.disk import replace_file
from core.archive.take import MINIMUM_RUNS
from core.errors import InputError, ModelError
from core.surrogate.accuracy import Accuracy
from core.surrogate.model import Surrogate

Array = NDArray[np.float64]
LOG = "refinement.json"


@dataclass(frozen=True, slots=True)
class Plan:
    """How runs are added.

    start      runs of the first design; None: four for each input, and what training needs, as
               far as `most` allows
    batch      runs of a round
    most       runs in all, at which it ends
    elsewhere  share of the weight that is spread over the whole box
    """

    start: int | None = None
    batch: int = 4
    most: int = 60
    elsewhere: float = 0.05
    seed: int = 0

    def first(self, d: int) -> int:
        """Size of the first design of d inputs.

        >>> Plan().first(4), Plan().first(2), Plan(most=15).first(4)
        (16, 9, 15)
        """
        need = MINIMUM_RUNS * (d + 1)
        for name, value, verb in (
            ("start", self.start, "start with"),
            ("most", self.most, "allow"),
        ):
            if value is not None and value < need:
                problem = f"runs are too few for {d} inputs"
                raise InputError(name, value, problem, f"{verb} {need} or more")
        return min(max(need, 4 * d), self.most) if self.start is None else self.start

    def check(self) -> None:
        """Raises InputError for numbers that make no sense."""
        for name, value in (("batch", self.batch), ("most", self.most)):
            if value < 1:
                raise InputError(name, value, "is not positive", "give 1 or more")
        if self.start is not None and self.start > self.most:
            problem = f"runs are more than there may be in all, {self.most}"
            raise InputError("start", self.start, problem, "start with fewer, or allow more")
        if not 0 <= self.elsewhere <= 1:
            raise InputError("elsewhere", self.elsewhere, "is no share", "give 0 … 1")


@dataclass(frozen=True, slots=True)
class Round:
    """One round: what was known from `runs` runs, and what it asked for.

    first, points  index of the first new run and the new inputs (n, d); none in the last round
    region         what it rested on, in words
    held_out       rms error of each quantity at runs left out, in its unit
    """

    runs: int
    accuracy: tuple[Accuracy, ...]
    region: str
    held_out: Mapping[str, float]
    first: int
    points: tuple[tuple[float, ...], ...]
    seconds: float

    def to_json(self) -> dict[str, Any]:
        own = {name: getattr(self, name) for name in self.__slots__}
        rows = [{k: getattr(one, k) for k in one.__slots__} for one in self.accuracy]
        return own | {"accuracy": rows, "held_out": dict(self.held_out)}

    @staticmethod
    def from_json(told: Mapping[str, Any]) -> Round:
        rows = tuple(Accuracy(**row) for row in told["accuracy"])
        points = tuple(tuple(float(v) for v in point) for point in told["points"])
        return Round(**{**told, "accuracy": rows, "points": points})


@dataclass(frozen=True, slots=True)
class Refined:
    """What a refinement came to; `failed`: runs that are missing, with the reason."""

    surrogate: Surrogate
    rounds: tuple[Round, ...]
    failed: Mapping[int, str]

    @property
    def reached(self) -> bool:
        """Whether every goal is met."""
        return all(one.met for one in self.rounds[-1].accuracy)

    @property
    def verdict(self) -> str:
        """One sentence: the accuracy is reached, or by how much it is not."""
        last = self.rounds[-1]
        told = ", ".join(map(str, last.accuracy))
        if self.reached:
            return f"accuracy reached after {last.runs} runs: {told}"
        worst = max(one.p95 / one.wanted for one in last.accuracy)
        return f"fell short by a factor of {worst:.3g} after {last.runs} runs: {told}"


def read_log(folder: str | Path) -> tuple[Round, ...]:
    """The rounds of an archive's folder; none where it has no log."""
    file = Path(folder) / LOG
    if not file.exists():
        return ()
    try:
        return tuple(Round.from_json(one) for one in json.loads(file.read_text())["rounds"])
    except (ValueError, KeyError, TypeError) as error:
        raise ModelError(f"{file} cannot be read: {error!r}; move it away to start anew") from error


def write_log(archive: Archive, rounds: Sequence[Round]) -> None:
    """The log, whole or not at all."""
    text = json.dumps({"rounds": [one.to_json() for one in rounds]}, indent=1)
    replace_file(archive.path / LOG, lambda part: part.write_text(text + "\n"))


def planned(rounds: Sequence[Round]) -> dict[int, Array]:
    """Every point that a round asked for, by the index of its run."""
    return {one.first + k: np.array(x) for one in rounds for k, x in enumerate(one.points)}


def free(done: Sequence[int], rounds: Sequence[Round]) -> int:
    """The first index that no run has and no round asked for."""
    return 1 + max([-1, *done, *planned(rounds)])
