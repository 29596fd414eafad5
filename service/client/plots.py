"""Pictures of answers, for notebooks and reports.

Each function takes answers, or the frames made of them (`frames`), draws into `axes` (None: a new
figure) and returns the axes::

    axes = plots.band(twin.prediction_frame("r1", "B01"), twin.readings_frame("r1"), limit=0.9)
    axes.figure.savefig("B01.png")

What differs by colour differs by its mark or its place as well.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from service.client import framed
from service.client.drawing import (
    GROUPS,
    INK,
    LIMIT,
    LINE,
    SOFT,
    SOURCES,
    draw_limit,
    draw_readings,
    draw_sources,
    label_blades,
    label_hours,
    legend,
    new_axes,
    new_rows,
    title,
)
from service.client.framed import Answer

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame

NAMED = 7  # groups with a name where there are more than `GROUPS`
NORMAL_95 = 1.959964


def band(
    prediction: Answer | DataFrame,
    readings: Iterable[Answer] | DataFrame | None = None,
    limit: float | None = None,
    *,
    component: str = "z",
    axes: Axes | None = None,
) -> Axes:
    """A blade's mean and band over the hours, with what each source adds to the band.

    readings    those of its blade and quantity (and node) that are one number, ± sigma where they
                tell it; late, replaced and retracted ones have marks of their own
    limit       [unit]
    component   of a vector

    From the inside out the sources' sds are added in quadrature: after the first k of them the
    band has the share √(Σ sd²) / √(Σ sd² of all) of its width, and with the last the whole.
    """
    frame = _framed(prediction, framed.prediction)
    facts = frame.attrs
    vector = frame.columns.nlevels == 2
    if vector:
        frame = frame.xs(component, axis="columns", level="component")
    axes = axes or new_axes()
    hours, mean = frame.index.to_numpy(), frame["mean"].to_numpy()
    draw_sources(axes, frame)
    axes.plot(hours, mean, color=LINE, lw=1.6, label="mean")
    if readings is not None and not vector:
        draw_readings(axes, _framed(readings, framed.readings), facts)
    draw_limit(axes, limit, facts["unit"])
    title(axes, facts, f"{100 * facts['probability']:g} % band by source")
    place = f", {component}" if vector else ""
    place += "" if facts["node"] is None else f", node {facts['node']}"
    label_hours(axes)
    axes.set_ylabel(f"{facts['quantity']} of {facts['blade']}{place} [{facts['unit']}]")
    legend(axes)
    return axes


def parameters(
    posterior: Answer,
    model: Answer | None = None,
    *,
    axes: Sequence[Axes] | None = None,
) -> Sequence[Axes]:
    """A row for each parameter: mean, 68 % (thick) and 95 % interval (thin).

    model   the answer of `twin.model(…)`, for the units
    axes    as many as parameters, one above the other
    """
    told: Any = posterior
    found = told["parameters"]
    units = _units(model, list(found))
    rows = list(axes) if axes is not None else new_rows(len(found))
    if len(rows) != len(found):
        raise ValueError(f"{len(rows)} axes for {len(found)} parameters: give one for each")
    for row, (name, one) in zip(rows, found.items(), strict=True):
        q = {level: one["quantiles"][level] for level in ("0.025", "0.16", "0.84", "0.975")}
        row.hlines(0, q["0.025"], q["0.975"], color=LINE, lw=1.2)
        row.hlines(0, q["0.16"], q["0.84"], color=SOURCES["parameters"][1], lw=5, alpha=0.6)
        row.plot(one["mean"], 0, "o", color=INK, ms=5)
        row.set_yticks([])
        row.set_ylim(-1, 1)
        row.margins(x=0.08)
        row.locator_params(axis="x", nbins=5)
        row.tick_params(axis="x", labelsize=8, pad=1)
        row.spines[["left", "right", "top"]].set_visible(False)
        unit = f" [{units[name]}]" if units[name] else ""
        row.set_ylabel(name + unit, rotation=0, ha="right", va="center")
        row.annotate(
            f"{one['mean']:.3g} ± {one['sd']:.2g}", (1.01, 0.5), xycoords="axes fraction",
            va="center", fontsize=8, annotation_clip=False,
        )  # fmt: skip
    if rows:
        whose = told.get("blade", "shared by its blades")
        title(rows[0], told, f"{whose}: mean, 68 and 95 %")
    return rows


def _units(model: Answer | None, names: Sequence[str]) -> dict[str, str]:
    if model is None:
        return dict.fromkeys(names, "")
    from core.network import Network
    from service.export.units import unit_of

    told: Any = model
    network = Network.from_json(told["network"])
    return {name: unit_of(network, name) for name in names}


def residuals(
    residuals: Answer | DataFrame, *, by: str = "campaign", axes: Axes | None = None
) -> Axes:
    """Each reading's z, as it was foreseen before it was used, against the blade's hours.

    by   blade, campaign, instrument or quantity: what colours and marks tell apart. Of more than
         14 groups those with the largest \\|z\\| have a name

    A model that is adequate has 95 % of them between the lines at ±2.
    """
    frame = _framed(residuals, framed.residuals)
    axes = axes or new_axes()
    axes.axhspan(-2, 2, color=SOURCES["parameters"][1], alpha=0.07, lw=0)
    for z in (-2, 2):
        axes.axhline(z, color=SOFT, lw=1, ls="--")
    axes.axhline(0, color=SOFT, lw=0.8)
    whose = frame[by].fillna(f"no {by}")
    worst = frame["z"].abs().groupby(whose).max().sort_values(ascending=False)
    named = sorted(worst.index if len(worst) <= len(GROUPS) else worst.index[:NAMED])
    for group, (colour, mark) in zip(named, GROUPS, strict=False):
        some = frame[whose == group]
        axes.plot(some["time_h"], some["z"], mark, ms=5, color=colour, alpha=0.85, label=group)
    rest = frame[~whose.isin(named)]
    if len(rest):
        label = f"{len(worst) - len(named)} others"
        axes.plot(
            rest["time_h"], rest["z"], "o", ms=4, color=SOFT, alpha=0.5, zorder=1.5, label=label
        )
    most = max(3.0, 1.1 * float(frame["z"].abs().max())) if len(frame) else 3.0
    axes.set_ylim(-most, most)
    label_hours(axes)
    axes.set_ylabel("z, residual over its predicted sd")
    title(axes, frame.attrs, "readings before they were used")
    legend(axes, by)
    return axes


def rotor(
    blades: Answer | DataFrame,
    limit: float | None = None,
    *,
    component: str = "z",
    axes: Axes | None = None,
) -> Axes:
    """The blades' predictions at one hour, by slot: mean with 95 % of the blade and of a reading.

    limit       [unit]; a mean at it or beyond has a mark of its own
    component   of a vector

    Bars are ± 1.96 sd, thick without a reading's noise and thin with it. Blades stand by their
    slots' numbers, those without one after them by name; open dots have left.
    """
    frame = _framed(blades, framed.blades)
    end = "" if "mean" in frame else f"_{component}"
    places = frame["slot"].fillna("")
    number = [int(s) if s.isascii() and s.isdigit() else np.inf for s in places]
    frame = frame.iloc[np.lexsort((frame.index.to_numpy(dtype=str), np.array(number, dtype=float)))]
    axes = axes or new_axes()
    at, mean = np.arange(len(frame)), frame[f"mean{end}"].to_numpy()
    fine = min(1.0, 30 / max(len(frame), 1))
    for sd, width, label in (("sd", 1.0, "a reading, 95 %"), ("sd_blade", 3.5, "the blade, 95 %")):
        half = NORMAL_95 * frame[f"{sd}{end}"].to_numpy() if len(frame) else mean
        colour = SOFT if sd == "sd" else SOURCES["parameters"][1]
        axes.vlines(
            at,
            mean - half,
            mean + half,
            color=colour,
            lw=max(0.6, width * fine),
            alpha=0.7,
            label=label,
        )
    past = np.zeros(len(mean), bool) if limit is None else mean >= limit
    left = frame["retired"].to_numpy()
    for some, mark, colour, face, label in (
        (~past & ~left, "o", INK, INK, "mean"),
        (past & ~left, "^", LIMIT, LIMIT, "mean past the limit"),
        (left, "o", INK, "white", "has left"),
    ):
        if some.any():
            axes.plot(
                at[some],
                mean[some],
                mark,
                ms=max(3.0, 5 * fine),
                color=colour,
                mfc=face,
                label=label,
            )
    draw_limit(axes, limit, frame.attrs["unit"])
    label_blades(axes, frame)
    facts = frame.attrs
    title(axes, facts, f"at {facts['time_h']:,.0f} h")
    axes.set_ylabel(f"{facts['quantity']}{end.replace('_', ' ')} [{facts['unit']}]")
    legend(axes)
    return axes


def _framed(given: Any, make: Any) -> DataFrame:
    """What was given as a frame already, or a frame of the answer."""
    return given if hasattr(given, "columns") else make(given)
