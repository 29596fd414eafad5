"""The sweep over ranks of a reduction (`core.reduction.sweep`): its numbers, their table and plot.

Beside it stands what the paper says: 20 features hold 99 % of the variance, and the error is
below 1 %.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from core.reduction.dense import Basis
    from core.reduction.sweep import Sweep

PAPER_RANK, VARIANCE, ERROR = 20, 0.99, 0.01


def told(basis: Basis, seen: Sweep, unseen: Sweep | None) -> dict[str, Any]:
    """The numbers of one basis: variance, errors by rank, and the ranks that suffice."""
    from core.reduction.sweep import rank_for

    ranks = list(seen.ranks)
    left = [float(basis.residual()[r - 1] ** 2 / basis.total) for r in ranks]
    facts: dict[str, Any] = {
        "ranks": ranks,
        "variance_left": _round(left),
        "rank_for_variance": rank_for(left, ranks, 1 - VARIANCE),
    }
    for name, one in (("training", seen), ("held_out", unseen)):
        if one is None:
            continue
        names = [part.name for part in one.parts]
        facts[name] = {
            "error": {n: _round(row) for n, row in zip(names, one.error, strict=True)},
            "worst_run": {n: _round(row) for n, row in zip(names, one.worst, strict=True)},
            "rmse": {
                f"{part.name} [{part.unit}]": _round(row)
                for part, row in zip(one.parts, one.rmse, strict=True)
            },
            "overall": _round(one.overall),
            "rank_for_error": rank_for(one.overall.tolist(), ranks, ERROR),
            "paper_rmse": _round(one.paper_rmse),
            "paper_magnitude": float(f"{one.paper_magnitude:.4g}"),
        }
    return facts


def _round(values: Sequence[float] | np.ndarray[Any, Any]) -> list[float]:
    return [float(f"{float(v):.4g}") for v in values]


def table(facts: dict[str, Any]) -> str:
    """The result as a page of Markdown, beside what the paper says."""
    joint = facts["joint"]
    errors = "held_out" if "held_out" in joint else "training"
    own, ranks = joint[errors], joint["ranks"]
    at = max(k for k, r in enumerate(ranks) if r <= PAPER_RANK)
    runs = facts["runs"]
    seen, unseen = (
        f"{100 * one['paper_rmse'][at] / one['paper_magnitude']:.2g} %"
        for one in (joint["training"], own)
    )
    what = errors.replace("_", " ")
    lines = [
        f"# Reduction of {runs['training']} runs, mesh {facts['mesh']}",
        "",
        f"{facts['nodes']:,} nodes × {facts['instants']} instants × {len(facts['quantities'])} "
        f"quantities; {runs['held_out']} runs held out. {facts['seconds']:g} s, "
        f"{facts['peak_mb']:,} MB.",
        "",
        f"| {ranks[at]} joint features | here | paper |",
        "|---|---|---|",
        f"| variance explained | {100 * (1 - joint['variance_left'][at]):.3f} % | 99 % |",
        f"| RMSE over all numbers, of their mean magnitude, training | {seen} | < 1 % |",
        f"| the same, {what} | {unseen} | not told |",
        f"| error of a quantity (root mean square of the six), {what} | "
        f"{100 * own['overall'][at]:.2g} % | not told |",
        f"| features for 99 % of the variance | {_some(joint['rank_for_variance'])} | 20 |",
        f"| features for 1 % error ({what}) | {_some(own['rank_for_error'])} | not told |",
        "",
        f"Error of reconstruction in % of the quantity's root mean square, {what}:",
        "",
        "| basis | quantity | " + " | ".join(map(str, ranks)) + " |",
        "|---" * (2 + len(ranks)) + "|",
    ]
    for basis, one in {
        "joint": joint,
        **{f"own {k}": v for k, v in facts["single"].items()},
    }.items():
        rows = one[errors]["error"]
        for name, row in rows.items():
            cells = [f"{100 * v:.3g}" for v in row] + [""] * (len(ranks) - len(row))
            label = "joint" if basis == "joint" else "its own"
            lines.append(f"| {label} | {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _some(rank: int | None) -> str:
    return "more" if rank is None else str(rank)


def sweep_plot(facts: dict[str, Any], file: Path) -> None:
    """Variance left and held-out error by rank: jointly, and each quantity's own basis."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt
    from matplotlib.lines import Line2D

    joint = facts["joint"]
    errors = "held_out" if "held_out" in joint else "training"
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.6), layout="constrained")
    colours = {name: f"C{k}" for k, name in enumerate(facts["quantities"])}
    left.plot(joint["ranks"], _left(joint), "k-o", ms=3.5, lw=1.8, label="joint")
    for name, one in facts["single"].items():
        left.plot(one["ranks"], _left(one), "--", color=colours[name], lw=1.2)
    left.axhline(100 * (1 - VARIANCE), color="0.6", lw=0.8, ls=":")
    left.set_ylabel("variance of the training runs not explained [%]")
    own = joint[errors]["error"]
    for name, row in own.items():
        right.plot(joint["ranks"], 100 * np.array(row), "-", color=colours[name], label=name)
        if name in facts["single"]:
            alone = facts["single"][name]
            row = alone[errors]["error"][name]
            right.plot(alone["ranks"], 100 * np.array(row), "--", color=colours[name], lw=1.2)
    right.axhline(100 * ERROR, color="0.6", lw=0.8, ls=":")
    what = "held-out runs" if errors == "held_out" else "training runs"
    right.set_ylabel(f"error of {what} [% of root mean square]")
    for axis in (left, right):
        axis.set_yscale("log")
        axis.set_xlabel("features")
        axis.axvline(PAPER_RANK, color="0.6", lw=0.8, ls=":")
        axis.grid(alpha=0.25, which="both", lw=0.4)
    handles, labels = right.get_legend_handles_labels()
    handles += left.get_legend_handles_labels()[0]
    labels += ["all quantities"]
    if facts["single"]:
        handles.append(Line2D([], [], color="0.3", ls="--", lw=1.2))
        labels.append("a basis of its own")
    figure.legend(handles, labels, loc="outside lower center", ncols=5, frameon=False, fontsize=9)
    runs = facts["runs"]
    figure.suptitle(
        f"{runs['training']} runs of {facts['nodes']:,} nodes × {facts['instants']} instants "
        f"(dotted: 20 features, 99 % of the variance, 1 % error)",
        fontsize=11,
    )
    figure.savefig(file, dpi=120)
    plt.close(figure)


def _left(one: dict[str, Any]) -> Any:
    return 100 * np.array(one["variance_left"])
