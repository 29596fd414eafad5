"""The loop as a picture: forecasts of the outage that was never posted, before and after."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np

from core.builtin.worn_plan import LOTS, coating_lot
from service.demo.result import Json

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

mpl.use("Agg")
COLOURS = dict(zip(LOTS, ("#1f5fa8", "#c0392b", "#2e8b57"), strict=True))
GREY = "#555555"


def draw_loop(loop: Json, path: Path) -> Figure:
    """Errors of the forecasts by blade and coating lot in both models, and the amplitudes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14, 5.2), dpi=110, layout="constrained")
    before, after, sizes = figure.subplots(1, 3, width_ratios=(1, 1, 0.75))
    after.sharey(before)
    for axis, when in ((before, "before"), (after, "after")):
        _errors(axis, loop["held_out"][when], loop[when])
        axis.set_title(f"{when} what was found is in the model", fontsize=10)
    before.set_ylabel("forecast − reading at the fourth outage [mm]")
    before.legend(fontsize=8, loc="upper left", ncols=3)
    effects = loop["diagnosis"]["result"]["effects"]
    for row, one in enumerate(effects):
        size = one["amplitude"]
        expected = loop["planted"].get(one["name"], {}).get("amplitude")
        scale = expected or size["mean"]
        sizes.errorbar(
            size["mean"] / scale, row, xerr=1.96 * size["sd"] / abs(scale),
            fmt="o", color=COLOURS[LOTS[0]], capsize=3,
        )  # fmt: skip
        told = f"{size['mean']:.3g} ± {size['sd']:.2g} {size['of']}"
        beside = _planted(one["name"], loop["planted"])
        sizes.annotate(
            f"{one['name']}\n{told}\n{beside}", (0.03, row + 0.16),
            xycoords=("axes fraction", "data"), fontsize=8, va="bottom",
            bbox={"color": "white", "pad": 1.0},
        )  # fmt: skip
    sizes.axvline(1.0, color=GREY, lw=1, ls="--")
    sizes.set_xlim(0, 2)
    sizes.set_ylim(-0.5, len(effects) - 0.1)
    sizes.set_yticks([])
    sizes.set_xticks([0.0, 0.5, 1.0, 1.5, 2.0])
    sizes.set_xlabel("amplitude over the planted one, or over its mean")
    sizes.set_title("what was adopted, with 95 % intervals", fontsize=10)
    figure.savefig(path)
    return figure


def _planted(name: str, planted: Json) -> str:
    """What was planted under this name, or on the same blades or readings under another."""
    if name in planted:
        return f"planted: {planted[name]['amplitude']:g} {planted[name]['of']}"
    whom = name[name.find("(") :]
    other = [
        f"{n.split(' (')[0]}, {p['amplitude']:g} {p['of']}" for n, p in planted.items() if whom in n
    ]
    return f"planted: {'; '.join(other) or 'nothing of the kind'}"


def _errors(axis: Axes, held_out: Json, told: Json) -> None:
    """Forecast less reading of each blade, with the 95 % band, by coating lot."""
    for lot, colour in COLOURS.items():
        own = [(b, h) for b, h in held_out.items() if coating_lot(b) == lot]
        at = [int(b[1:4]) for b, _ in own]
        rows = np.array([h for _, h in own])
        miss, half = rows[:, 2] - rows[:, 1], 0.5 * (rows[:, 4] - rows[:, 3])
        axis.errorbar(
            at, miss, yerr=half, fmt="o", ms=3, lw=0.7, color=colour, ecolor=colour + "55",
            label=f"coating lot {lot}",
        )  # fmt: skip
        axis.hlines(miss.mean(), min(at), max(at), color=colour, lw=2)
    axis.axhline(0.0, color=GREY, lw=1, ls="--")
    error, bias, worn = (1e3 * told[n] for n in ("rmse_mm", "bias_mm", "worn_lot_bias_mm"))
    axis.set_xlabel(
        f"blade\nerror {error:.0f} µm, bias {bias:+.0f} µm, of the worn lot {worn:+.0f} µm, "
        f"{told['coverage_95']:.0%} in their bands"
    )
