"""A user's runs and network become a surrogate, with a word on how good it is.

Held-out errors (ten-fold cross-validation, `core.surrogate.held_out`) are compared with the spread
between runs and with the noise that a reading is expected to have, the middle of its prior:

    rms error > half the spread between runs    refused: it tells hardly more than the mean run
    rms error > expected noise                  a warning: readings are judged by the surrogate's
                                                error, which calibration counts, not by their noise
    rms error > a quarter of the noise          a remark in the table alone

and so is what the calibration's polynomials add (`core.surrogate.compile`), at seeded points of the
box. The surrogate's own error is part of every likelihood and band, so a poor one makes wide bands,
not wrong ones; that is why only one that knows next to nothing is refused.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.archive.faults import Findings
from core.archive.source import Source
from core.archive.store import Archive
from core.archive.take import take
from core.errors import InputError
from core.network import Network, Quantity
from core.prior import Prior
from core.response import CALIBRATED
from core.rng import stream
from core.surrogate.artefact import save
from core.surrogate.compact import compact
from core.surrogate.followed import Followed
from core.surrogate.model import Surrogate
from core.surrogate.training import train

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]
NO_BETTER = 0.5  # of the spread between runs
SAMPLES, MOST_NODES = 256, 8


@dataclass(frozen=True, slots=True)
class Quality:
    """How a quantity is learnt; all in its unit.

    rms, p95     error at runs left out; coverage is in the bands by construction
    spread       between runs; noise: expected sd of a reading (the middle of its prior)
    polynomials  rms that compiling to polynomials adds
    worst        label of the run that is worst when left out, and its rms error
    """

    quantity: str
    unit: str
    rms: float
    p95: float
    spread: float
    noise: float
    polynomials: float
    worst: str
    worst_rms: float

    @property
    def share(self) -> float:
        """Of the spread between runs that is missed."""
        return self.rms / max(self.spread, np.finfo(float).tiny)

    @property
    def verdict(self) -> str:
        """good, fair, poor or useless."""
        if self.share > NO_BETTER:
            return "useless"
        largest = max(self.rms, self.polynomials)
        if largest > self.noise:
            return "poor"
        return "fair" if largest > 0.25 * self.noise else "good"

    def to_json(self) -> dict[str, Any]:
        own = {name: getattr(self, name) for name in self.__slots__}
        return own | {"share_of_spread": self.share, "verdict": self.verdict}


def expected_noise(prior: Prior) -> float:
    """The middle of a noise's prior: its median.

    >>> round(expected_noise(Prior("log_uniform", 0.01, 1.0)), 6)
    0.1
    """
    return float(prior.quantile(np.array(0.5)))


def make(
    source: Source,
    network: Network,
    folder: str | Path,
    *,
    leave_out: Sequence[str] = (),
    seed: int = 0,
    progress: Progress | None = None,
    facts: dict[str, Any] | None = None,
) -> tuple[Surrogate, Findings]:
    """The surrogate in `folder` (``arrays.npz``, ``manifest.json``), and the warnings.

    The runs that were taken lie below it, in ``runs``. `facts` go into the manifest, beside
    ``training``, ``quality`` (by quantity) and ``warnings``.

    Raises RunsError with every fault, and where a quantity is not learnt.
    """
    folder = Path(folder)
    archive, found, chosen = take(
        source, network, folder / "runs", leave_out=leave_out, progress=progress
    )
    surrogate = compact(train(archive, chosen, seed=seed, progress=progress))
    if network.drifts or network.of_level("dormant"):
        _followed(surrogate, network, found)
    rows = quality(surrogate, archive, network, source.labels, chosen)
    for row in rows:
        judge(row, found)
    found.end()
    notes = {
        **surrogate.manifest,
        "source": source.name,
        "command": archive.declaration.command,
        "seed": seed,
        "runs": len(chosen),
        "kind": "runs of a user's own",
        "quality": {row.quantity: row.to_json() for row in rows},
        "warnings": [one.to_json() for one in found.warnings],
        **(facts or {}),
    }
    return save(replace(surrogate, manifest=notes), folder), found


def _followed(surrogate: Surrogate, network: Network, found: Findings) -> None:
    """Refuse what was not learnt so that inputs which run in time, or sleep, can move it."""
    for q in network.quantities:
        try:
            Followed.of(surrogate, q.name, None if q.kind == "scalar" else [0])
        except InputError as error:
            found.fault(f"quantity {q.name}", None, error.problem, error.remedy)


def quality(
    surrogate: Surrogate,
    archive: Archive,
    network: Network,
    labels: Sequence[str],
    chosen: Sequence[int],
) -> list[Quality]:
    """A row for each quantity of the network."""
    held = surrogate.manifest["training"]["held_out"]
    rows = []
    for q in network.quantities:
        one = held[q.name]
        rows.append(
            Quality(
                quantity=q.name,
                unit=q.unit,
                rms=one["rms"],
                p95=one["p95"],
                spread=one["spread"],
                noise=expected_noise(q.sigma_obs),
                polynomials=polynomial_rms(surrogate, q),
                worst=labels[chosen[int(one["worst"])]],
                worst_rms=one["worst_rms"],
            )
        )
    return rows


def polynomial_rms(surrogate: Surrogate, quantity: Quantity, seed: int = 0) -> float:
    """Rms that `response` adds to `predict`, over seeded points of the box and five hours."""
    rng = stream(seed, "polynomials", quantity.name)
    x = rng.uniform(surrogate.low, surrogate.high, (SAMPLES, len(surrogate.inputs)))
    times = surrogate.horizon_h * np.array([0.1, 0.25, 0.5, 0.75, 1.0])
    nodes = None
    if quantity.kind != "scalar":
        count = surrogate.node_count
        named = sorted(set(surrogate.named.values()))
        nodes = named or np.unique(np.linspace(0, count - 1, MOST_NODES).astype(int)).tolist()
    direct, _ = surrogate.predict(x, quantity.name, times, nodes)
    compiled, _ = surrogate.response(quantity.name, times, nodes, CALIBRATED).evaluate(x)
    return float(np.sqrt(np.mean((compiled - direct.reshape(len(x), -1)) ** 2)))


def judge(row: Quality, found: Findings) -> None:
    """Refuse or warn, by the rules of the module's text."""
    what = f"surrogate of {row.quantity}"
    off = f"{row.rms:.3g} {row.unit}"
    worst = f"run {row.worst}, when it is left out, by {row.worst_rms:.3g}"
    if row.verdict == "useless":
        problem = (
            f"is its rms error at runs left out, {100 * row.share:.0f} % of their spread "
            f"({row.spread:.3g}): it knows hardly more than the mean run; worst is {worst}"
        )
        remedy = "add runs or inputs that are missing, and look at the worst run"
        found.fault(what, off, problem, remedy)
    elif row.rms > row.noise:
        problem = "is its rms error at runs left out, above the noise that a reading is expected "
        problem += f"to have, {row.noise:.3g}: bands are wide by it; worst is {worst}"
        found.warn(what, off, problem, f"add runs, or widen sigma_obs of {row.quantity}")
    if row.verdict == "poor" and row.polynomials > row.noise:
        problem = "is what its polynomials are off, above a reading's expected noise"
        shown = f"{row.polynomials:.3g} {row.unit}"
        remedy = "narrow the inputs' bounds: the response is too crooked for one box"
        found.warn(f"polynomials of {row.quantity}", shown, problem, remedy)
