"""`bladetwin model refine`: runs where they are needed, until a stated accuracy."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from core.errors import InputError
from service.commands import Json, say
from service.commands.reach import reached

if TYPE_CHECKING:
    from core.archive import Archive
    from core.network import Network
    from core.surrogate.accuracy import Goal
    from core.surrogate.refine import Regions
    from core.surrogate.rounds import Round
    from service.refining import Source

ROW = "{:>5} {:>5}  {:<44} {:<32} {}"


def refine(
    runs: Annotated[Path, typer.Argument(help="Folder of the runs; goes on with what is there.")],
    network: Annotated[
        Path | None, typer.Option(help="The network's declaration; default: the rotor blade's.")
    ] = None,
    served: Annotated[str | None, typer.Option(help="URL of an UM-Bridge server.")] = None,
    command: Annotated[str | None, typer.Option(help="Program that makes one run.")] = None,
    mesh: Annotated[str, typer.Option(help="Of the built-in finite elements.")] = "default",
    times: Annotated[str, typer.Option(help="Hours of a run, as in 0,500,1000,4000.")] = "",
    nodes: Annotated[int, typer.Option(help="Nodes of the fields that a command writes.")] = 0,
    rotor: Annotated[str | None, typer.Option(help="Rotor whose posterior weighs runs.")] = None,
    url: Annotated[str, typer.Option(help="Of the rotor's service.")] = "http://127.0.0.1:8000",
    key: Annotated[str | None, typer.Option(help="An API key with read.")] = None,
    readings: Annotated[
        Path | None, typer.Option(help="CSV of readings, in place of a rotor.", exists=True)
    ] = None,
    accuracy: Annotated[
        list[str] | None,
        typer.Option(help="Relative sd wanted, as elongation=0.01, or a number for all; 0.01."),
    ] = None,
    hours: Annotated[str, typer.Option(help="Hours at which it is wanted.")] = "",
    start: Annotated[int | None, typer.Option(help="Runs of the first design.")] = None,
    batch: Annotated[int, typer.Option(help="Runs of a round.")] = 4,
    most: Annotated[int, typer.Option(help="Runs in all.")] = 60,
    elsewhere: Annotated[float, typer.Option(help="Weight's share over the whole box.")] = 0.05,
    workers: Annotated[int, typer.Option(help="Runs at once; UM-Bridge: one.", min=1)] = 2,
    model: Annotated[str | None, typer.Option(help="UM-Bridge name, of several.")] = None,
    config: Annotated[str, typer.Option(help="JSON of the UM-Bridge model's options.")] = "{}",
    timeout: Annotated[float, typer.Option(help="Longest wait for one run, s.")] = 3600.0,
    seed: Annotated[int, typer.Option(help="Seed of designs and calibrations.")] = 0,
    as_json: Json = False,
) -> None:
    """Add runs where posterior mass and surrogate error meet, until the accuracy is reached.

    Without --served or --command the runs are the built-in finite elements of the rotor blade;
    without --rotor or --readings the whole prior counts. Exit status 1: the accuracy was not
    reached, or runs failed; the others are there, and the same command goes on.
    """
    from core.surrogate.refine import refine as run
    from core.surrogate.rounds import Plan
    from service.commands.telling import steps, telling
    from service.refining import FiniteElements, network_of

    shown: list[Round] = []
    with telling(as_json), _source(network, served, command, mesh, times, nodes, workers, model,
                                   config, timeout) as (source, declared):  # fmt: skip
        plan = Plan(start, batch, most, elsewhere, seed)
        plan.check()
        goals = goals_of(accuracy or ["0.01"], _hours(hours, "hours"), declared)
        archive = source.open(runs, seed)
        if isinstance(source, FiniteElements):
            declared = network_of(archive)
        regions, words = _regions(declared, archive, rotor, url, key, readings, seed)
        for sentence in words if not as_json else ():
            typer.echo(sentence, err=True)

        def seen(made: Round, surrogate: object) -> None:
            shown.append(made)
            if not as_json:
                typer.echo(line(len(shown), made), err=True)

        with steps(quiet=as_json) as progress:
            found = run(archive, source.run, regions, goals, plan, progress=progress, seen=seen)
    failed = [{"run": k, "error": why} for k, why in sorted(found.failed.items())]
    told: dict[str, Any] = {"folder": str(runs), "reached": found.reached, "runs": shown[-1].runs}
    told |= {"verdict": found.verdict, "rounds": [one.to_json() for one in found.rounds]}
    lines = [f"{runs}: {found.verdict}", *(f"run {one['run']}: {one['error']}" for one in failed)]
    say(told | {"failed": failed}, lines, as_json=as_json)
    if failed or not found.reached:
        raise typer.Exit(1)


def line(number: int, made: Round) -> str:
    """A round on one line: number, runs, what is reached, rms errors left out [unit], region."""
    reached = ", ".join(map(str, made.accuracy))
    held = ", ".join(f"{name} {rms:.3g}" for name, rms in made.held_out.items())
    return ROW.format(number, made.runs, reached, f"rms left out: {held}", made.region)


def goals_of(texts: Sequence[str], hours: tuple[float, ...], network: Network) -> list[Goal]:
    """``elongation=0.01``, or a number for every quantity of the network.

    Raises InputError for what is neither, and for a quantity that the network does not have.
    """
    from core.surrogate.accuracy import Goal

    names = [q.name for q in network.quantities]
    wanted: dict[str, float] = {}
    for text in texts:
        name, _, number = text.rpartition("=")
        try:
            value = float(number)
        except ValueError:
            remedy = "write elongation=0.01, or 0.01"
            raise InputError("accuracy", text, "is no relative sd", remedy) from None
        if name and name not in names:
            raise InputError("accuracy", name, "is no quantity", f"use {', '.join(names)}")
        wanted |= dict.fromkeys([name] if name else names, value)
    return [Goal(name, value, hours) for name, value in wanted.items()]


def _hours(text: str, what: str) -> tuple[float, ...]:
    try:
        return tuple(float(one) for one in text.split(",") if one.strip())
    except ValueError:
        raise InputError(what, text, "are no hours", "write 0,500,1000,4000") from None


@contextmanager
def _source(
    network: Path | None, served: str | None, command: str | None, mesh: str, times: str,
    nodes: int, workers: int, model: str | None, config: str, timeout: float,
) -> Iterator[tuple[Source, Network]]:  # fmt: skip
    """What makes runs, and the network; a connection to a server is closed at the end."""
    import json

    import httpx

    from core.builtin.paper_network import rotor_blade_network
    from service import refining, sampling
    from service.command_runs import Command
    from service.declared import read_file

    if served is not None and command is not None:
        raise InputError("command", command, "stands beside --served", "give one of them")
    if served is None and command is None:
        if network is not None:
            remedy = "add --served URL or --command, or leave --network out"
            raise InputError("network", str(network), "has no source of runs", remedy)
        yield refining.FiniteElements(mesh, workers), rotor_blade_network()
        return
    if network is None:
        remedy = "give --network FILE, as for `model sample`"
        raise InputError("network", None, "is missing", remedy)
    declared, instants = read_file(network), _hours(times, "times")
    if command is not None:
        yield (
            Command.of(
                command, declared, time_h=instants, nodes=nodes, workers=workers, timeout=timeout
            ),
            declared,
        )
        return
    try:
        options = json.loads(config)
    except ValueError as error:
        raise InputError("config", config, f"is no JSON: {error}", "see --help") from None
    with httpx.Client(base_url=str(served), timeout=timeout) as http:
        one = sampling.Served(http, model, options)
        yield refining.ServedModel(one, declared, instants), declared


def _regions(
    network: Network,
    archive: Archive,
    rotor: str | None,
    url: str,
    key: str | None,
    readings: Path | None,
    seed: int,
) -> tuple[Regions, list[str]]:
    """Whose posterior weighs the runs, and what a user should know of it."""
    from core.posterior_region import from_readings, prior_regions
    from service.refining import readings_of

    if rotor is not None and readings is not None:
        raise InputError("readings", str(readings), "stands beside --rotor", "give one of them")
    if rotor is None and readings is None:
        return prior_regions(network, seed), []
    words: list[str] = []
    known: Mapping[str, Mapping[str, float]] = {}
    if rotor is not None:
        with reached(url, key) as twin:
            told, body = twin.rotor(rotor), twin.readings_csv(rotor)
        there = [one for one in told["blades"] if not one["retired"]]
        blades = {one["id"] for one in there}
        known = {one["id"]: one["known"] or {} for one in told["blades"]}
        if told["network"]:
            words.append(
                f"warning: rotor {rotor} varies its network; runs are weighed by the plain one"
            )
    else:
        assert readings is not None
        body, blades = readings.read_bytes(), set()
    found = readings_of(body, network, archive) if len(body.strip().splitlines()) > 1 else []
    if not found:
        words.append("warning: there is no reading: the whole prior counts")
        return prior_regions(network, seed), words
    blades |= {one.blade for one in found}
    return from_readings(network, sorted(blades), found, known=known, seed=seed), words
