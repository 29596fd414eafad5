"""``bladetwin diagnose``: which effects a rotor's model lacks, asked over HTTP.

Exit status 0: the model is adequate. 3: it is not, whatever the verdict names (effect, not
separable, unattributed). 1: the diagnosis failed, was cancelled, or could not be asked for. An
interrupted command leaves the diagnosis running; the same command finds it again.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from core.errors import BladetwinError, InputError
from service.commands.blade_table import around
from service.commands.diagnosis_files import read_families, write
from service.commands.reach import reached
from service.report import noticed
from service.report.alternatives import hypothesis, names
from service.report.split import what_to_read
from service.report.words import p_of

if TYPE_CHECKING:
    from service.client import Client

Told = dict[str, Any]
LOOK_S = 1.0
CONFLICT = 409
UNNAMED = " (with a discrepancy that names no cause)"
LACKS = 3  # exit status where the model lacks something
SHOWN = 10


class DiagnosisError(BladetwinError):
    """A diagnosis that ended without a verdict."""


@contextmanager
def shown(*, quiet: bool) -> Iterator[Callable[[Told], None]]:
    """Progress and time left on a terminal's stderr; call what it yields with a diagnosis."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn

    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description:<40.40}"),
        BarColumn(),
        TextColumn("{task.fields[left]}"),
    )
    with Progress(*columns, console=console, disable=quiet or not console.is_terminal) as bars:
        task = bars.add_task("queued", total=None, left="")

        def show(told: Told) -> None:
            now = told["progress"]
            if now is None:
                bars.update(task, description=told["status"])
                return
            left = now["seconds_left"]
            text = f"{now['done']}/{now['total']}" + (
                "" if left is None else f", ≤ {left:.0f} s left"
            )
            bars.update(
                task,
                description=now["what"],
                completed=now["done"],
                total=now["total"],
                left=text,
            )

        yield show


def awaited(twin: Client, told: Told, show: Callable[[Told], None], look_s: float) -> Told:
    """The diagnosis once it has ended."""
    try:
        while told["status"] in ("queued", "running"):
            show(told)
            time.sleep(look_s)
            told = {**twin.diagnosis(told["rotor"], told["id"])}
    except KeyboardInterrupt:
        on = f"bladetwin: diagnosis {told['id']} of {told['rotor']} goes on; the same command finds"
        typer.echo(f"{on} it again.", err=True)
        raise
    return told


def amplitude(effect: Told, found: Told) -> str:
    """How large an effect is, in its unit, and of what.

    found  the diagnosis, where an effect of an older release has its unit
    """
    drawn = (found.get("pictures") or {}).get("amplitudes", ())
    units = {one["name"]: one["unit"] for one in drawn}
    size = effect["amplitude"]
    unit = size.get("unit", units.get(effect["name"]))
    told = around(size["mean"], size["sd"])
    return f"{told} {'' if unit in (None, '', '1') else f'{unit} '}{size['of']}"


def lines_of(told: Told) -> Iterator[str]:
    """A diagnosis that has a result, as a short table."""
    found = told["result"]
    readings, rests = found["readings"], found["rests_on"]
    p = "" if found["p"] is None else f" (p {p_of(found)})"
    yield f"rotor {told['rotor']}: {found['verdict']}{p}"
    yield from (f"  {reason}" for reason in found["reasons"])
    if why := found.get("not_adopted"):
        yield f"  the rotor did not adopt it by itself: {why}"
    entry = told.get("adoption") or {}
    if entry.get("what") == "adoption" and entry.get("unasked"):
        yield f"  the rotor adopted it by itself, with entry {entry['seq']}"
    if found["verdict"] == "not separable":
        yield "  one of: " + ", ".join(found["names"])
    yield from what_to_read(found.get("separating"))
    yield from noticed.lines(found)
    if found["effects"]:
        yield "effects" if found["claimed"] else "effects that were calibrated, not claimed"
    yield from (f"  {e['name']}: {amplitude(e, found)}" for e in found["effects"])
    if (compared := found["before_after"]) is not None:
        count, with_what = compared["before"]["count"], "" if found["claimed"] else UNNAMED
        yield f"{count} readings that neither model used, before → after{with_what}"
        for key in ("rmse", "bias", "log_score", "within_95", "width"):
            before, after = compared["before"][key], compared["after"][key]
            if before is not None and after is not None:
                yield f"  {key:<10} {before:>9.4g} → {after:.4g}"
    if others := found.get("alternatives"):
        yield (
            f"{others['quantity']} of {len(others['blades'])} blades at "
            f"{others['time_h']:,.10g} h, by "
            "what else the readings allow (share of the evidence, mean ± sd of a blade)"
        )
        for k, (name, one) in enumerate(zip(names(others), others["each"], strict=True), 1):
            told_of = f"{one['mean']:.4g} ± {one['sd']:.2g}"
            yield f"  {k} {100 * one['share']:>5.0f}% {told_of}  {name}"
        together = others["together"]
        yield f"  together {together['mean']:.4g} ± {together['sd']:.2g}"
        if "adoption" in others["each"][0]:
            how = f"bladetwin adopt {told['rotor']} {told['id']} --alternative 1 --because …"
            yield f"  who knows from elsewhere which it is: {how}"
    if found["calibrated"]:
        yield "calibrated: log evidence gained [nat]"
    for one in found["calibrated"]:
        yield f"  {one['gained_nat']:>z8.1f}  {hypothesis(one)}"
    if found["tried"]:
        yield f"tried: {len(found['tried'])}, by log Bayes factor; the first {SHOWN} at most"
    for one in found["tried"][:SHOWN]:
        gain = "-" if one["log_bf"] is None else f"{one['log_bf']:z.1f}"
        yield f"  {gain:>8}  {one['what']}"
    yield (
        f"rests on {readings['used']} of {readings['delivered']} readings through entry "
        f"{rests['through_seq']}"
    )


def adopted(twin: Client, rotor: str, diagnosis: str) -> Told:
    """The adoption; ``not_adopted`` says why where the rotor has gone on meanwhile."""
    from service.client import ProblemError

    try:
        return {**twin.adopt(rotor, diagnosis)}
    except ProblemError as error:
        if error.status != CONFLICT:
            raise
        return {"not_adopted": str(error)}


def adopted_line(told: Told) -> str:
    """What became of ``--adopt``."""
    if "not_adopted" in told:
        return "not adopted"
    if "head_seq" not in told:
        found = told["result"]
        if found["verdict"] == "unattributed" and (found.get("widened") or {}).get("borne_out"):
            yours = f"bladetwin adopt {told['rotor']} {told['id']}"
            return f"no effect to adopt; a discrepancy without a cause is borne out: {yours} has it"
        return f"nothing to adopt: the verdict is {found['verdict']}"
    return f"adopted, with entry {told['adoption']['seq']}; the new version follows"


def diagnose(
    rotor: Annotated[str, typer.Argument(help="The rotor.")],
    url: Annotated[str, typer.Option(help="The service.")] = "http://127.0.0.1:8000",
    key: Annotated[str | None, typer.Option(help="An API key with read and operate.")] = None,
    families: Annotated[
        Path | None, typer.Option(help="JSON file of families of effects to try as well.")
    ] = None,
    no_compare: Annotated[
        bool, typer.Option("--no-compare", help="Leave out the comparison before and after.")
    ] = False,
    adopt: Annotated[
        bool, typer.Option("--adopt", help="Adopt what the diagnosis names, if it does.")
    ] = False,
    html: Annotated[
        Path | None, typer.Option(help="Write the report, one HTML file, to this file.")
    ] = None,
    limit: Annotated[
        float | None,
        typer.Option(help="Of the forecast quantity: the report tells the life left until it."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Which effects a rotor's model lacks. Exit status 0: none; 3: some, named or not; 1: error."""
    own = [] if families is None else read_families(families)
    if limit is not None and html is None:
        raise InputError("--limit", limit, "is for the report", "give --html FILE as well")
    if limit is not None and not math.isfinite(limit):
        raise InputError("--limit", limit, "is no number", "give it in the quantity's unit")
    if html is not None and not html.absolute().parent.is_dir():
        raise InputError("--html", str(html), "lies in no folder", "make the folder first")
    with reached(url, key) as twin, shown(quiet=as_json) as show:
        asked = twin.diagnose(rotor, families=own, compare=not no_compare)
        told = awaited(twin, {**asked}, show, LOOK_S)
        if html is not None and told["status"] == "done":
            write(html, twin.report(rotor, told["id"], limit=limit))
        if adopt and told["status"] == "done" and told["result"]["verdict"] == "effect":
            told |= adopted(twin, rotor, told["id"])
    if as_json:
        typer.echo(json.dumps(told))
    if told["status"] != "done":
        why = told["error"] or "somebody cancelled it"
        raise DiagnosisError(f"diagnosis {told['id']} of {rotor} is {told['status']}: {why}")
    if not as_json:
        typer.echo("\n".join(lines_of(told)))
        if adopt:
            typer.echo(adopted_line(told))
    if "not_adopted" in told:
        raise DiagnosisError(str(told["not_adopted"]))
    if told["result"]["verdict"] != "adequate":
        raise typer.Exit(LACKS)
