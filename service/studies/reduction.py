"""`bladetwin study reduction`: how few numbers the runs of an archive can be told with."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from service.progress import bar
from service.studies import app
from service.studies.rank_sweep import sweep_plot, table, told
from service.studies.result import commit, write

if TYPE_CHECKING:
    from core.reduction.runs import RunRows

OUT = Path("tests/claims/results/reduction")
RANKS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 24, 28, 32, 40, 48, 56, 64)
Tell = Callable[[str, int, int], None]


@app.command()
def reduction(
    archive: Annotated[Path, typer.Option(help="Folder of the runs.", exists=True)],
    training: Annotated[
        int, typer.Option(help="Runs that the basis is made of, the first ones.", min=2)
    ] = 66,
    rank: Annotated[int, typer.Option(help="Features at most.", min=1)] = 32,
    joint_only: Annotated[
        bool, typer.Option("--joint-only", help="No bases of single quantities.")
    ] = False,
    seed: Annotated[int, typer.Option(help="Seed of the random samples.")] = 1,
    out: Annotated[Path, typer.Option(help="Folder of the result, its table and plot.")] = OUT,
) -> None:
    """Randomised SVD of an archive, out of core: variance, held-out reconstruction, ranks.

    Held out are the runs behind the first `--training`; where there are none, every sixth run.
    """
    from core.archive import Archive
    from core.reduction.runs import RunRows

    start, made_by = time.monotonic(), commit()
    store = Archive.open(archive)
    done = store.done()
    kept, held = split(done, training)
    with ExitStack() as bars:
        shown: dict[str, Callable[[int], None]] = {}

        def tell(what: str, step: int, total: int) -> None:
            if what not in shown:
                shown[what] = bars.enter_context(bar(what, total))
            shown[what](step)

        rows = RunRows.of(store, kept)
        chosen = {"joint": rows} | {
            part.name: rows.only(part.name) for part in rows.parts if not joint_only
        }
        found = {
            name: reduced(own, held, rank, seed, lambda *step, name=name: tell(name, *step))
            for name, own in chosen.items()
        }
    declared = store.declaration
    facts: dict[str, Any] = {
        "mesh": declared.mesh,
        "nodes": declared.nodes,
        "instants": len(declared.time_h),
        "quantities": [part.name for part in rows.parts],
        "numbers_of_a_run": rows.shape[1],
        "code": declared.code,
        "runs": {"training": len(kept), "held_out": len(held)},
        "seed": seed,
        "seconds": round(time.monotonic() - start, 1),
        "peak_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024),
    }
    facts["joint"] = found["joint"]
    facts["single"] = {name: one for name, one in found.items() if name != "joint"}
    write(facts, made_by, out)
    (out / "table.md").write_text(table(facts))
    sweep_plot(facts, out / "rank-sweep.png")


def split(done: Sequence[int], training: int) -> tuple[list[int], list[int]]:
    """Runs of the basis, and runs that are held out.

    >>> split(range(5), 3)
    ([0, 1, 2], [3, 4])
    >>> split(range(7), 7)
    ([0, 1, 2, 3, 4, 6], [5])
    """
    first, behind = [k for k in done if k < training], [k for k in done if k >= training]
    if behind:
        return first, behind
    return [k for n, k in enumerate(first) if n % 6 != 5], first[5::6]


def reduced(
    rows: RunRows, held: Sequence[int], rank: int, seed: int, tell: Callable[[int, int], None]
) -> dict[str, Any]:
    """A basis of `rows`, and what it loses of them and of held-out runs."""
    from core.reduction.streamed import streamed_svd
    from core.reduction.sweep import sweep

    large = rows.shape[1] > 1_000_000
    _, basis = streamed_svd(
        rows, rank, seed, dtype=np.float32 if large else np.float64, progress=tell
    )
    ranks = [r for r in RANKS if r <= basis.modes.shape[1]]
    seen = sweep(rows, basis, ranks)
    unseen = sweep(rows.others(held), basis, ranks) if held else None
    return told(basis, seen, unseen)
