"""Fields of a blade, or of a rotor, over hours, as files that are computed while they are sent."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.errors import InputError, RangeError
from service.errors import FaultsError, NotFoundError
from service.export import series as files
from service.export.arrow import ArrowStream
from service.export.vtu import vtu
from service.handlers.blades import blades_at, blades_of
from service.handlers.exports import facts_of
from service.handlers.glance import field, field_question
from service.handlers.reads import Basis, held_from
from service.ports import BladeRecord, Json, Mesh, Science, Store

Array = NDArray[np.float64]
MOST_FILES = 400
MOST_VALUES = 8_000_000


@dataclass(frozen=True, slots=True)
class Series:
    """Fields that were asked for: a quantity of some blades at rising hours [h].

    everyone   all blades of the rotor, where the series is of a rotor
    done       called with how many of its `count` fields there are, each a second or more
    """

    quantity: str
    hours: tuple[float, ...]
    blades: tuple[BladeRecord, ...]
    everyone: tuple[BladeRecord, ...] = ()
    done: Callable[[int], None] = lambda number: None

    @property
    def count(self) -> int:
        return len(self.hours) * len(self.blades)


def asked(found: Basis, quantity: str | None, times: Sequence[float] | None) -> Series:
    """A series of the blade that the basis names, checked; hours: by default the model's instants.

    FaultsError: no field, hours outside the model's horizon, or hours that do not rise.
    """
    assert found.blade is not None
    return _checked(found, quantity, times, [found.blade])


def of_rotor(
    store: Store,
    found: Basis,
    quantity: str | None,
    times: Sequence[float] | None,
    names: Sequence[str] | None,
) -> Series:
    """A series of the rotor's blades that run in this version, or of those named.

    Where a blade stands in the rotor follows from all of its blades.
    """
    state = found.state
    with store.read() as tx:
        blades = blades_at(blades_of(tx, state.rotor_id), state.through_seq)
    there = {blade.id: blade for blade in sorted(blades, key=lambda blade: blade.id)}
    if names is None:
        names = [b.id for b in there.values() if not b.retired_seq]
    if twice := sorted(name for name, count in Counter(names).items() if count > 1):
        raise InputError("blades", ", ".join(twice), "is named twice", "name each blade once")
    for name in names:
        if name not in there:
            remedy = f"GET /v1/rotors/{state.rotor_id}/blades lists them"
            raise NotFoundError(f"blade in version {state.version}", name, remedy)
    wanted = _checked(found, quantity, times, [there[name] for name in sorted(names)])
    return replace(wanted, everyone=tuple(there.values()))


def _checked(
    found: Basis,
    quantity: str | None,
    times: Sequence[float] | None,
    blades: Sequence[BladeRecord],
) -> Series:
    hours = found.card.time_h if times is None else tuple(times)
    name, _ = field_question(found.card, quantity, None)
    faults: list[InputError] = []
    horizon = found.card.horizon_h
    if outside := [t for t in hours if not 0 <= t <= horizon]:
        problem = f"lies outside 0 … {horizon:g} h, which the model covers"
        faults.append(RangeError("times", outside[0], problem, "ask for hours inside"))
    if any(b <= a for a, b in pairwise(hours)):
        faults.append(
            InputError("times", list(hours), "do not rise", "give each hour once, sorted")
        )
    wanted = Series(name, hours, tuple(blades))
    if not 1 <= wanted.count <= MOST_FILES:
        problem = f"are {len(hours)} hours of {len(blades)} blades"
        remedy = f"ask for 1 … {MOST_FILES} fields at once: fewer `times`, or some `blades`"
        faults.append(RangeError("times", wanted.count, problem, remedy))
    if faults:
        raise FaultsError(faults)
    return wanted


def mesh_of(science: Science, found: Basis) -> Mesh:
    """The model's mesh. NotFoundError: it has none that is known."""
    mesh = science.mesh(found.card)
    if mesh is None:
        remedy = "its runs gave the nodes no places (points): use format=npz"
        raise NotFoundError("mesh of model", found.card.id, remedy)
    return mesh


def pvd(
    store: Store, science: Science, found: Basis, wanted: Series, mesh: Mesh, *, ring: bool
) -> Iterator[bytes]:
    """A zip of a PVD and its VTU files.

    ring   the blades stand around the rotor's axis, else where the model has its one blade; so
           they do on a user's mesh, of which nothing tells where such an axis is
    """
    names = [blade.id for blade in wanted.blades]
    turned = ring and not mesh.own
    places = files.angles(wanted.blades, wanted.everyone) if turned else [None] * len(names)

    def written() -> Iterable[tuple[str, bytes]]:
        yield "field.pvd", files.pvd(names, wanted.hours)
        fields = _fields(store, science, found, wanted)
        for part, (blade, angle) in enumerate(zip(wanted.blades, places, strict=True)):
            of_blade = replace(found, blade=blade)
            placed = (
                mesh if angle is None else replace(mesh, points=files.turned(mesh.points, angle))
            )
            for step, told in enumerate(islice(fields, len(wanted.hours))):
                yield files.vtu_name(part, blade.id, step), _vtu(placed, told, of_blade, angle)

    return files.zipped(written())


def _fields(store: Store, science: Science, found: Basis, wanted: Series) -> Iterator[Json]:
    """The answers of ``GET …/field``, blade after blade and hour after hour."""
    every = ((blade, hour) for blade in wanted.blades for hour in wanted.hours)
    for number, (blade, hour) in enumerate(every, 1):
        told = field(store, science, replace(found, blade=blade), wanted.quantity, hour)
        wanted.done(number)
        yield told


def _vtu(mesh: Mesh, told: Json, found: Basis, angle: float | None) -> bytes:
    """The answer of ``GET …/field`` on a mesh; vectors turned with the blade."""
    name, unit = told["quantity"], told["unit"]
    mean, sd = np.array(told["mean"]), np.array(told["sd"])
    facts: dict[str, Any] = {name: told[name] for name in ("blade", "quantity", "time_h")}
    facts |= facts_of(found) | {"held_from_h": json.dumps(told["held_from_h"])}
    if angle is not None:
        facts |= {"turned_rad": angle, "sd_axes": "the blade's own"}
        mean = files.turned(mean, angle) if mean.ndim == 2 else mean
    data = {f"{name} mean [{unit}]": mean, f"{name} sd [{unit}]": sd}
    return vtu(mesh, data, float(told["time_h"]), facts)


def _facts(store: Store, science: Science, found: Basis, wanted: Series) -> dict[str, Any]:
    """Of a file of one blade over hours."""
    (blade,) = wanted.blades
    held = held_from(science, found, found.arrays(store), blade)
    facts = {"blade": blade.id, "quantity": wanted.quantity} | facts_of(found)
    return facts | {"held_from_h": json.dumps(held)}


def arrow(store: Store, science: Science, found: Basis, wanted: Series) -> Iterator[bytes]:
    """An Arrow stream with a batch for each hour. Raises NotInstalledError, before it begins."""
    output = found.card.outputs[wanted.quantity]
    facts = _facts(store, science, found, wanted)
    stream = ArrowStream(vector=output.kind == "vector", unit=output.unit, facts=facts)

    def told() -> Iterator[tuple[float, Array, Array]]:
        fields = _fields(store, science, found, wanted)
        for hour, one in zip(wanted.hours, fields, strict=True):
            yield hour, np.array(one["mean"]), np.array(one["sd"])

    return stream.batches(told())


def npz(store: Store, science: Science, found: Basis, wanted: Series) -> Iterator[bytes]:
    """A zip of arrays: `time_h` (T,), `mean` and `sd` (T, N[, 3]); RangeError: too many values."""
    output = found.card.outputs[wanted.quantity]
    each = 2 * found.card.node_count * (3 if output.kind == "vector" else 1)
    if len(wanted.hours) * each > MOST_VALUES:
        problem = f"hours of {each} values each are more than {MOST_VALUES} values"
        remedy = f"ask for {max(MOST_VALUES // each, 1)} hours at once"
        raise RangeError("times", len(wanted.hours), problem, remedy)
    told = list(_fields(store, science, found, wanted))
    arrays = {"time_h": np.array(wanted.hours)}
    arrays |= {what: np.array([one[what] for one in told]) for what in ("mean", "sd")}
    facts = _facts(store, science, found, wanted)
    return files.npz(arrays, output.unit, facts)
