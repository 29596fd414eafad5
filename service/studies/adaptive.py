"""`bladetwin study adaptive`: adaptive against one-shot designs, and its plot."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from service.commands.telling import steps
from service.studies import app
from service.studies.result import commit, write

KINDS = (
    ("one_shot", "one-shot maximin", "#7f7f7f", "s"),
    ("uniform", "adaptive, uniform weight (control)", "#d68910", "^"),
    ("adaptive", "adaptive, posterior weight", "#1f3b63", "o"),
)


@app.command()
def adaptive(
    seeds: Annotated[int, typer.Option(help="Rotors, at most five.", min=1, max=5)] = 5,
    designs: Annotated[int, typer.Option(help="Sets of one-shot designs.", min=1)] = 2,
    pool: Annotated[int, typer.Option(help="Test runs of each rotor.", min=4)] = 20,
    seed: Annotated[int, typer.Option(help="Seed of designs, noise and test runs.")] = 7,
    processes: Annotated[int, typer.Option(help="Processes that compute runs.")] = 1,
    work: Annotated[
        Path, typer.Option(help="Folder of the runs; a cut study goes on there.")
    ] = Path("bladetwin-data/adaptive"),
    out: Annotated[Path | None, typer.Option(help="Folder of the result and its plot.")] = None,
) -> None:
    """Runs that adaptive and one-shot designs need for the same error in a rotor's posterior."""
    from dataclasses import asdict

    from core.validation import adaptive as study
    from core.validation.adaptive_counts import summary

    start, made_by = time.monotonic(), commit()
    chosen = study.Study(seeds=seeds, designs=designs, pool=pool, seed=seed)
    with steps(quiet=False) as progress:
        rows = study.run(chosen, work, processes=processes, progress=progress)
    facts: dict[str, Any] = {"study": asdict(chosen), "runs_by": "finite elements, mesh coarse"}
    facts |= {"seconds": round(time.monotonic() - start, 1), "summary": summary(rows)}
    write(facts | {"seeds": rows}, made_by, out)
    if out is not None:
        curves_plot(rows, out / "error.png")


def curves_plot(rows: Sequence[Mapping[str, Any]], file: Path) -> None:
    """Error over runs, a panel for each rotor, and the ratios of all in the last one."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt
    from matplotlib.ticker import FixedLocator, NullFormatter, ScalarFormatter

    columns = min(3, len(rows) + 1)
    height = -(-(len(rows) + 1) // columns)
    figure, axes = plt.subplots(
        height, columns, figsize=(3.9 * columns, 3.3 * height + 0.6), squeeze=False,
        layout="constrained",
    )  # fmt: skip
    panels = list(axes.ravel())
    every = [100 * p["rms"] for row in rows for kind, *_ in KINDS for p in row[kind]]
    low, high = 0.8 * min(every), 1.25 * max(every)
    levels = [v for v in (0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50) if low <= v <= high]
    for panel, row in zip(panels, rows, strict=False):
        for kind, label, colour, mark in KINDS:
            n, e = [p["n"] for p in row[kind]], [100 * p["rms"] for p in row[kind]]
            panel.loglog(n, e, color=colour, marker=mark, ms=4.5, lw=1.4, label=label)
        panel.set_ylim(low, high)
        panel.yaxis.set_major_locator(FixedLocator(levels))
        panel.xaxis.set_major_locator(FixedLocator([p["n"] for p in row["one_shot"]]))
        for axis in (panel.xaxis, panel.yaxis):
            axis.set_major_formatter(ScalarFormatter())
            axis.set_minor_formatter(NullFormatter())
        ratio = row["ratios"]["ratio"]
        panel.set_title(
            f"rotor {row['rotor'] + 1}, T1T {row['region']['mean'][1]:.3f}: "
            f"ratio of runs {ratio:.2f}", fontsize=9,
        )  # fmt: skip
        panel.set_xlabel("runs", fontsize=9)
        panel.set_ylabel("rms error of elongation [%]", fontsize=9)
        panel.tick_params(labelsize=8)
        panel.grid(alpha=0.25, lw=0.6)
    last = panels[len(rows)]
    for name, (_, _, colour, mark) in zip(("uniform_ratios", "ratios"), KINDS[1:], strict=True):
        for k, row in enumerate(rows):
            for one in row[name]["by_size"]:
                face = colour if one["reached"] else "none"
                last.plot(
                    one["size"] * (1 + 0.012 * (k - len(rows) / 2)), one["ratio"],
                    marker=mark, ms=5, color=colour, mfc=face, ls="",
                )  # fmt: skip
    last.axhline(0.70, color="0.4", lw=1, ls="--")
    last.set_xticks([one["size"] for one in rows[0]["ratios"]["by_size"]])
    last.set_ylim(bottom=0)
    last.set_xlabel("size of the one-shot design", fontsize=9)
    last.set_ylabel("runs needed for its error / its size", fontsize=9)
    last.set_title("all rotors; dashed: 0.70; open: not reached, at least", fontsize=9)
    last.tick_params(labelsize=8)
    for panel in panels[len(rows) + 1 :]:
        panel.set_visible(False)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3, frameon=False, fontsize=9)
    figure.savefig(file, dpi=110)
    plt.close(figure)
