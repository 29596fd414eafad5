"""How the commands on a user's own runs tell: faults, warnings, steps and held-out errors.

What is wrong is listed fault by fault on stderr, and the exit status is 1; warnings go there as
well. With ``--json`` both are in the one object on stdout.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import typer

from core.errors import FaultsError

if TYPE_CHECKING:
    from core.archive.faults import Findings


ROW = "{:<22} {:<8} {:>10} {:>10} {:>10} {:>10} {:>8}  {}"


def table(rows: dict[str, Any]) -> list[str]:
    """Held-out errors by quantity, against spread and expected noise."""
    heads = ("quantity", "unit", "rms", "95 %", "spread", "noise", "of it", "verdict")
    lines = [ROW.format(*heads)]
    for name, row in rows.items():
        numbers = (f"{row[key]:.3g}" for key in ("rms", "p95", "spread", "noise"))
        share = f"{100 * row['share_of_spread']:.1f} %"
        verdict = f"{row['verdict']} (worst: run {row['worst']}, {row['worst_rms']:.3g})"
        lines.append(ROW.format(name, row["unit"], *numbers, share, verdict))
    return lines


@contextmanager
def telling(as_json: bool) -> Iterator[None]:
    """Every fault on a line of its own, and exit status 1."""
    try:
        yield
    except FaultsError as error:
        warnings = getattr(error, "warnings", ())
        if as_json:
            told = {"faults": [one.to_json() for one in error.faults]}
            typer.echo(json.dumps(told | {"warnings": [one.to_json() for one in warnings]}))
        for one in warnings if not as_json else ():
            typer.echo(f"warning: {one}", err=True)
        for one in error.faults if not as_json else ():
            typer.echo(f"fault: {one}", err=True)
        count = len(error.faults)
        typer.echo(f"bladetwin: refused for {count} fault{'s' * (count != 1)}", err=True)
        raise typer.Exit(1) from None


def warn(found: Findings, as_json: bool) -> None:
    """Warnings on stderr, where they are not in the object."""
    for one in found.warnings if not as_json else ():
        typer.echo(f"warning: {one}", err=True)


@contextmanager
def steps(*, quiet: bool) -> Iterator[Callable[[str, int, int], None]]:
    """A bar for each kind of step, on a terminal."""
    from contextlib import ExitStack

    from service.progress import bar

    shown: dict[str, Callable[[int], None]] = {}
    with ExitStack() as bars:

        def progress(what: str, done: int, total: int) -> None:
            if what not in shown:
                shown[what] = bars.enter_context(bar(what, total, quiet=quiet))
            shown[what](done)

        yield progress


def warnings_of(found: Findings) -> list[dict[str, object]]:
    return [one.to_json() for one in found.warnings]


def sentence(one: dict[str, Any]) -> str:
    return f"{one['field']} = {one['value']!r} {one['problem']}. To mend it: {one['remedy']}."
