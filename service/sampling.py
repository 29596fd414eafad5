"""Runs from a model that is served over UM-Bridge (its protocol 1.0, JSON over HTTP).

The network names the parameters and quantities; the served model has to take and give them in that
order: its input blocks, joined, are the parameters, its output blocks the quantities, each a course
over the instants (T,), a field (T, N) or vectors (T, N, 3), row by row. One block that holds all of
them is split. Points are maximin in the parameters' bounds; runs that are there are not asked for
again, so a sampling that was cut goes on where it was.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from numpy.typing import NDArray

from core.archive import Archive, Input, Mesh, Quantity, Run
from core.archive.changes import declared_faults
from core.archive.check import DEFORMATION, DISPLACEMENT, KINDS
from core.design import maximin_lhs
from core.errors import FaultsError, InputError, ModelError
from core.network import Network, Parameter
from core.rng import seed_of

Array = NDArray[np.float64]
Json = dict[str, Any]
PROTOCOL = 1.0
TRIES = 3
ENDS = ("low", "high")


class Served:
    """One model of an UM-Bridge server."""

    def __init__(self, http: httpx.Client, name: str | None, config: Json) -> None:
        self._http, self._config = http, config
        info = self._call("GET", "/Info", None)
        if float(info.get("protocolVersion", 0)) != PROTOCOL:
            version = info.get("protocolVersion")
            raise ModelError(f"the server speaks UM-Bridge {version}, this release {PROTOCOL}")
        models = [str(one) for one in info.get("models", [])]
        if name is None and len(models) == 1:
            name = models[0]
        if name not in models:
            raise InputError("model", name, "is not served there", f"use one of {models}")
        self.name = name
        can = self._call("POST", "/ModelInfo", {"name": name})
        if not can.get("support", {}).get("Evaluate"):
            raise ModelError(f"model {name!r} is served without Evaluate: it cannot be run")
        told = {"name": name, "config": config}
        self.input_sizes = self._sizes(self._call("POST", "/InputSizes", told), "inputSizes")
        self.output_sizes = self._sizes(self._call("POST", "/OutputSizes", told), "outputSizes")

    def __call__(self, x: Array) -> Array:
        """All outputs, joined, at inputs x (d,)."""
        cuts = np.cumsum(self.input_sizes)[:-1]
        blocks = [[float(v) for v in block] for block in np.split(x, cuts)]
        body = {"name": self.name, "input": blocks, "config": self._config}
        output = self._call("POST", "/Evaluate", body).get("output")
        try:
            values = np.concatenate(
                [np.asarray(block, dtype=float).ravel() for block in output or []]
            )
        except (TypeError, ValueError) as error:
            raise ModelError(f"model {self.name!r} answers what is no numbers: {error}") from error
        if len(values) != sum(self.output_sizes):
            wanted = sum(self.output_sizes)
            raise ModelError(f"model {self.name!r} answers {len(values)} numbers, not {wanted}")
        return values

    def _call(self, method: str, path: str, body: Json | None) -> Json:
        """An answer; ModelError where the model refuses, or the server cannot be reached."""
        for left in reversed(range(TRIES)):
            try:
                answer = self._http.request(method, path, json=body)
                told = answer.json()
                break
            except httpx.TimeoutException as error:  # the run may go on there: not asked twice
                said = f"{path} had no answer in time ({type(error).__name__})"
                raise ModelError(f"{self._http.base_url}: {said}") from error
            except httpx.TransportError as error:
                if not left:
                    raise ModelError(f"{self._http.base_url} does not answer: {error}") from error
            except ValueError as error:
                raise ModelError(f"{path} of {self._http.base_url} answers no JSON") from error
        if not isinstance(told, dict) or "error" in told or answer.is_error:
            said = told.get("error", told) if isinstance(told, dict) else told
            raise ModelError(f"{path} of {self._http.base_url}: {said}")
        return told

    def _sizes(self, told: Json, name: str) -> list[int]:
        sizes = told.get(name)
        if not isinstance(sizes, list) or not all(isinstance(n, int) and n > 0 for n in sizes):
            raise ModelError(f"the server's {name} are {sizes!r}, no list of sizes")
        return sizes


@dataclass(frozen=True, slots=True)
class Sampled:
    """What a sampling came to: runs that are there, and those that failed with the reason."""

    done: int
    failed: tuple[tuple[int, str], ...]


def sample(
    served: Served,
    network: Network,
    archive_dir: str,
    time_h: Sequence[float],
    design: int,
    *,
    seed: int = 0,
    progress: Callable[[int], None] = lambda done: None,
) -> Sampled:
    """Run `design` maximin points that the archive lacks.

    Raises InputError where the served model does not fit the network and the instants.
    """
    told = f"bladetwin model sample, UM-Bridge model {served.name}, {design} points"
    archive = begin(served, network, archive_dir, time_h, seed, told)
    low, high = (np.array([getattr(i, e) for i in archive.declaration.inputs]) for e in ENDS)
    points = maximin_lhs(design, low, high, seed_of(seed, "sample", served.name, design))
    there, failed = set(archive.done()), []
    progress(len(there))
    for k, x in enumerate(points):
        if k in there:
            continue
        try:
            run_one(served, archive, k, x)
        except (ModelError, InputError) as error:
            failed.append((k, str(error)))
        else:
            there.add(k)
            progress(len(there))
    return Sampled(len(there), tuple(failed))


def begin(
    served: Served,
    network: Network,
    archive_dir: str | Path,
    time_h: Sequence[float],
    seed: int,
    command: str,
) -> Archive:
    """The archive of a served model's runs, new or gone on with.

    Raises InputError where the served model does not fit the network and the instants.
    """
    parameters = inputs_of(network)
    if sum(served.input_sizes) != len(parameters):
        names = ", ".join(p.name for p in parameters)
        problem = f"inputs are not the {len(parameters)} parameters of the network ({names})"
        remedy = "declare one parameter for each input, in their order"
        raise InputError(f"model {served.name}", sum(served.input_sizes), problem, remedy)
    nodes = _nodes(served, network, len(time_h))
    return archive_of(network, archive_dir, time_h, nodes, seed, command)


def inputs_of(network: Network) -> list[Parameter]:
    """The parameters that are inputs of a run."""
    return [p for p in network.parameters if p.level != "dormant"]


def quantities_of(network: Network) -> list[Quantity]:
    """What a run gives, as an archive declares it."""
    return [
        Quantity(DISPLACEMENT if q.name == DEFORMATION else q.name, q.unit, KINDS[q.kind])
        for q in network.quantities
    ]


def told_name(quantity: str, network: Network) -> str:
    """The network's name of an archive's quantity."""
    known = {q.name for q in network.quantities}
    return DEFORMATION if quantity == DISPLACEMENT and quantity not in known else quantity


def archive_of(
    network: Network,
    archive_dir: str | Path,
    time_h: Sequence[float],
    nodes: int,
    seed: int,
    command: str,
) -> Archive:
    """An archive of a network's inputs and quantities, on `nodes` nodes without a known mesh.

    FaultsError: no runs of these hours could serve the network (`check_declared`).
    """
    check_declared(network, max(time_h, default=0.0))
    shape = np.full((nodes, 3), np.nan), np.zeros((0, 0), np.int64), np.zeros((nodes, 3))
    return Archive.create(
        archive_dir,
        inputs=[Input(p.name, p.prior.low, p.prior.high) for p in inputs_of(network)],
        time_h=time_h,
        mesh=Mesh("own", *shape, {}) if nodes else Mesh.none(),
        seed=seed,
        command=command,
        quantities=quantities_of(network),
    )


def check_declared(network: Network, horizon_h: float) -> None:
    """Refuse, before a run is made, what training refuses of any runs that end at this hour."""
    if horizon_h > 0 and (found := list(declared_faults(network, horizon_h))):
        raise FaultsError(found)


def run_one(served: Served, archive: Archive, index: int, x: Array) -> None:
    """Run the served model at x (d,) and keep it as run `index`."""
    names = (one.name for one in archive.declaration.inputs)
    inputs = dict(zip(names, map(float, x), strict=True))
    archive.write(index, Run(inputs, _split(served(x), archive)))


def _nodes(served: Served, network: Network, instants: int) -> int:
    """The number of nodes of the outputs; InputError where their sizes do not fit."""
    quantities = quantities_of(network)
    width = {"scalar": 0, "field": 1, "vector field": 3}
    total = sum(served.output_sizes)
    scalars = sum(q.kind == "scalar" for q in quantities)
    per_node = sum(width[q.kind] for q in quantities)
    left = total - scalars * instants
    nodes, rest = divmod(left, instants * per_node) if per_node else (0, left)
    fits = rest == 0 and (nodes > 0 or not per_node)
    sizes = [instants * (width[q.kind] * nodes or 1) for q in quantities]
    if not fits or (len(served.output_sizes) > 1 and served.output_sizes != sizes):
        shown = ", ".join(f"{q.name} ({q.kind})" for q in quantities)
        problem = f"are not the sizes of {shown} at {instants} instants"
        remedy = "let each quantity be a block over the instants of --times, in the network's order"
        raise InputError(f"outputs of {served.name}", served.output_sizes, problem, remedy)
    return nodes


def _split(values: Array, archive: Archive) -> dict[str, Array]:
    declared = archive.declaration
    shapes = [declared.shape(q) for q in declared.quantities]
    cuts = np.cumsum([int(np.prod(shape)) for shape in shapes])[:-1]
    return {
        q.name: block.reshape(shape)
        for q, shape, block in zip(declared.quantities, shapes, np.split(values, cuts), strict=True)
    }
