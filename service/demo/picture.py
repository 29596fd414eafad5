"""The main job as a table and a picture with bands."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
from rich.console import Console
from rich.table import Table

from core.builtin.inspection_plan import HELD_OUT_H, OUTAGES_H, Plan, blades
from service.demo.loop import lines
from service.demo.result import LOCAL, SHOWN, Result

mpl.use("Agg")
BLUE, RED, GREY = "#1f5fa8", "#c0392b", "#555555"
LABEL = {
    "tbc_thickness": "coating thickness / nominal",
    "creep_transient": "transient creep α (sd)",
    "creep_steady": "steady creep γ (sd)",
}


def draw(result: Result, plan: Plan, path: Path) -> None:
    """Four panels: parameters, a blade's life, held-out readings, their errors in sd."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14, 9.5), dpi=110, layout="constrained")
    top, bottom = figure.subfigures(2, 1, squeeze=False)[:, 0]
    for axis, name in zip(top.subplots(1, 3), LOCAL, strict=True):
        rows = np.array([b[name] for b in result.local.values()])
        axis.errorbar(
            rows[:, 2], rows[:, 0], yerr=rows[:, 1], fmt="o", ms=3, lw=0.8, color=BLUE,
            ecolor="#9dbbe0", label="posterior mean ± 1 sd",
        )  # fmt: skip
        ends = [rows[:, 2].min(), rows[:, 2].max()]
        axis.plot(ends, ends, color=GREY, lw=1, ls="--", label="truth")
        axis.set_xlabel(f"true {LABEL[name]}")
        axis.set_ylabel("estimated")
        share = result.local_coverage(name)
        axis.set_title(f"{name}: truth within 1.96 sd for {share:.0%} of the blades", fontsize=10)
        axis.legend(fontsize=8, loc="upper left")
    life, held, errors = bottom.subplots(1, 3, width_ratios=(1.5, 1, 0.8))
    _life(life, result, plan)
    rows = np.array(list(result.held_out.values()))
    held.errorbar(
        rows[:, 1], rows[:, 2], yerr=[rows[:, 2] - rows[:, 3], rows[:, 4] - rows[:, 2]],
        fmt="o", ms=3, lw=0.8, color=BLUE, ecolor="#9dbbe0",
    )  # fmt: skip
    ends = [rows[:, 1].min(), rows[:, 1].max()]
    held.plot(ends, ends, color=GREY, lw=1, ls="--")
    held.set_xlabel("reading at the held-out outage [mm]")
    held.set_ylabel("forecast with 95 % band [mm]")
    held.set_title(f"{len(rows)} readings never posted: {result.coverage:.0%} inside", fontsize=10)
    z = (rows[:, 1] - rows[:, 2]) / rows[:, 5]
    errors.hist(z, bins=np.linspace(-4, 4, 17), density=True, color="#9dbbe0", edgecolor="white")
    grid = np.linspace(-4, 4, 200)
    errors.plot(grid, np.exp(-0.5 * grid**2) / np.sqrt(2 * np.pi), color=GREY, lw=1)
    errors.set_xlabel("(reading − forecast) / predicted sd")
    errors.set_ylabel("density")
    errors.set_title("errors against a unit normal", fontsize=10)
    t1t = result.shared["t1t_rate"]
    figure.suptitle(
        f"bladetwin: {result.rotor['applied_seq']} log entries, T1T rate {t1t[0]:.4f} ± "
        f"{t1t[1]:.4f} (truth {t1t[2]:.4f}), posterior version {result.rotor['version']}"
    )
    figure.savefig(path)


def _life(axis, result: Result, plan: Plan) -> None:  # type: ignore[no-untyped-def]
    """One blade: what it was told, what it foresees, what the finite elements say."""
    hours = np.array(result.curve["time_h"]) / 1000
    mean = np.array(result.curve["mean"])
    sd = {k: np.array(v) for k, v in result.curve["sd"].items()}
    own = np.sqrt(sd["parameters"] ** 2 + sd["surrogate"] ** 2 + sd["discrepancy"] ** 2)
    axis.fill_between(
        hours, result.curve["lower"], result.curve["upper"], color="#dce8f6",
        label="95 % band of a reading",
    )  # fmt: skip
    axis.fill_between(
        hours, mean - own, mean + own, color="#9dbbe0", label="± 1 sd of the blade itself"
    )
    axis.plot(hours, mean, color=BLUE, lw=1.5, label="predicted mean")
    i = blades().index(SHOWN)
    axis.plot(
        plan.time_h / 1000, plan.elongation[i], color=RED, lw=1.2, ls="--",
        label="finite elements (truth)",
    )  # fmt: skip
    told = [
        (r["time_h"] / 1000, r["value"])
        for r in plan.inspections
        if r["blade"] == SHOWN and r["quantity"] == "elongation"
    ]
    axis.plot(*np.array(told).T, "s", color="black", ms=5, label="inspections posted")
    axis.plot(
        HELD_OUT_H / 1000, plan.held_out[SHOWN][1], "s", mfc="white", mec="black", ms=6,
        label="held out",
    )  # fmt: skip
    axis.axvline(OUTAGES_H[-1] / 1000, color=GREY, lw=0.8, ls=":")
    axis.set_xlabel("operating hours [1000 h]")
    axis.set_ylabel("permanent tip elongation [mm]")
    axis.set_title(f"blade {SHOWN}: three inspections, then a forecast", fontsize=10)
    axis.legend(fontsize=8, loc="upper left")


def print_table(result: Result, out: Path) -> None:
    """Parameters against truth, coverage, seconds."""
    table = Table(title="The twin against the truth", title_justify="left")
    for column in ("", "mean", "sd", "truth"):
        table.add_column(column, justify="left" if not column else "right")
    for name, (mean, sd, true) in result.shared.items():
        table.add_row(name, f"{mean:.5g}", f"{sd:.2g}", "" if true is None else f"{true:.5g}")
    for name in LOCAL:
        rows = np.array([b[name] for b in result.local.values()])
        rmse = float(np.sqrt(np.mean((rows[:, 0] - rows[:, 2]) ** 2)))
        table.add_row(
            f"{name} (100 blades)", f"error {rmse:.3g}", f"{rows[:, 1].mean():.2g}",
            f"{result.local_coverage(name):.0%} in 95 %",
        )  # fmt: skip
    rmse, bias = result.forecast_error
    table.add_row("held-out reading [mm]", f"error {rmse:.3g}", f"bias {bias:+.2g}",
                  f"{result.coverage:.0%} in 95 %")  # fmt: skip
    console = Console()
    console.print(table)
    seconds = ", ".join(f"{k} {v:.1f} s" for k, v in result.seconds.items())
    for line in [] if result.loop is None else lines(result.loop):
        console.print(line, highlight=False)
    console.print(f"{seconds}\npicture: {out / 'demo.png'}, figures: {out / 'result.json'}")
