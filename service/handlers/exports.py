"""Draws of a rotor, and draws and fields as other tools read them."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from core.errors import RangeError
from core.observation import Inspection
from service.errors import NotFoundError
from service.export import sensorthings as entities
from service.export.netcdf import Replicated, inference_data
from service.export.readings import Parquet, csv_header, csv_text
from service.export.units import unit_of
from service.export.vtu import vtu
from service.handlers.blades import blades_at, blades_of
from service.handlers.glance import MOST_DRAWS
from service.handlers.listing import Log, pages_of
from service.handlers.plans import counting
from service.handlers.reads import Basis, health
from service.moments import moment
from service.ports import BladeRecord, Draws, JointDraws, Json, Science, Store
from service.release import release

MOST_VALUES = {"json": 400_000, "netcdf": 8_000_000}
GROUPS = ("prior", "posterior_predictive")
"""Of a file of draws, beside the posterior."""
ASKED = ("particles",)
"""Of such a file, where it is asked for by name."""


def rotor_draws(
    store: Store, science: Science, found: Basis, count: int, form: str
) -> tuple[JointDraws, list[BladeRecord]]:
    """Joint draws of all blades of a version, those that have left included.

    Raises RangeError where they would be more than an answer of this form should hold.
    """
    state = found.state
    with store.read() as tx:
        blades = blades_at(blades_of(tx, state.rotor_id), state.through_seq)
        blades = sorted(blades, key=lambda blade: blade.id)
        each = len(blades) * len(found.card.network.of_level("local"))
        most = min(MOST_DRAWS, MOST_VALUES[form] // max(each, 1))
        if not 1 <= count <= most:
            problem = f"is not a number of draws of {len(blades)} blades"
            other = ", or take format=netcdf" if form == "json" else ""
            raise RangeError("count", count, problem, f"ask for 1 … {most}{other}")
        get = tx.states.reader(state)
        drawn = science.joint_draws(state.meta, get, [blade.id for blade in blades], count)
    return drawn, blades


def told(drawn: JointDraws, found: Basis) -> Json:
    """Joint draws as plain lists."""
    return {
        "shared": {"names": list(drawn.shared_names), "values": drawn.shared.tolist()},
        "local": {"names": list(drawn.local_names), "values": drawn.local.tolist()},
        "blades": list(drawn.blades),
        "of": drawn.of,
        "health": health(found.state),
    }


def of_one_blade(drawn: Json, found: Basis, science: Science, store: Store) -> JointDraws:
    """Draws of one blade (`service.handlers.glance.draws`) told apart by their level."""
    assert found.blade is not None
    with store.read() as tx:
        reader = tx.states.reader(found.state)
        shared = science.shared_draws(found.state.meta, reader).names
    names, values = list(drawn["names"]), np.array(drawn["values"])
    local = tuple(name for name in names if name not in shared)
    return JointDraws(
        shared,
        values[:, [names.index(name) for name in shared]],
        local,
        (found.blade.id,),
        values[:, None, [names.index(name) for name in local]],
        drawn["of"],
    )


def facts_of(found: Basis) -> dict[str, str | int]:
    """What an answer rests on, flat, as attributes of a file can hold it."""
    rests = {
        k: str(v).lower() if v is True or v is False else v for k, v in found.to_json().items()
    }
    return {
        "created_at": moment(found.state.created_at),
        "inference_library": "bladetwin",
        "inference_library_version": release(),
        "health": json.dumps(health(found.state)),
        **rests,
        "untold": json.dumps(found.untold),
    }


def draws_netcdf(
    store: Store,
    science: Science,
    drawn: JointDraws,
    blades: list[BladeRecord],
    found: Basis,
    groups: Collection[str] = GROUPS,
) -> bytes:
    """Joint draws as netCDF in ArviZ's schema, with the other groups that are asked for.

    Raises RangeError where the replicated readings would be more than an answer should hold.
    """
    network = found.card.network
    known = {
        parameter.name: [(blade.known or {}).get(parameter.name, np.nan) for blade in blades]
        for parameter in network.of_level("known")
    }
    names = (*drawn.shared_names, *drawn.local_names, *known)
    units = {name: unit_of(network, name) for name in names}
    weights = "equal: drawn by systematic resampling from weighted particles, in random order"
    facts = facts_of(found) | {"weights": weights, "particles": drawn.of}
    again: list[Replicated] = []
    if "posterior_predictive" in groups:
        again = _replicated(store, science, drawn, blades, found)
    prior = science.prior_draws(found.card, drawn) if "prior" in groups else None
    own = _particles(store, science, drawn, found) if "particles" in groups else []
    return inference_data(drawn, units, known, facts, prior=prior, readings=again, particles=own)


def _particles(store: Store, science: Science, drawn: JointDraws, found: Basis) -> list[Draws]:
    """The weighted particles of these blades.

    Raises RangeError where they would be more than an answer should hold.
    """
    values = drawn.of * len(drawn.blades) * (len(drawn.shared_names) + len(drawn.local_names) + 2)
    if values > MOST_VALUES["netcdf"]:
        problem = f"{values} values of {len(drawn.blades)} blades are more than "
        problem += f"{MOST_VALUES['netcdf']}"
        raise RangeError("groups", "particles", problem, "ask for the draws of one blade")
    meta = found.state.meta
    with store.read() as tx:
        get = tx.states.reader(found.state)
        return [science.blade_draws(meta, get, blade) for blade in drawn.blades]


def _replicated(
    store: Store, science: Science, drawn: JointDraws, blades: list[BladeRecord], found: Basis
) -> list[Replicated]:
    """The readings of these blades that the version rests on, and what they would be again."""
    state = found.state
    with store.read() as tx:
        readings = [
            one
            for one in counting(tx, state.rotor_id, state.through_seq)
            if one.blade in drawn.blades
        ]
    most = MOST_VALUES["netcdf"] // max(sum(one.values.size for one in readings), 1)
    if len(drawn.shared) > most:
        problem = f"draws of {len(readings)} readings are more than {MOST_VALUES['netcdf']} values"
        remedy = f"ask for 1 … {most}, or leave them out with groups=prior"
        raise RangeError("count", len(drawn.shared), problem, remedy)
    known = {blade.id: blade.known for blade in blades if blade.known}
    told = science.replicated(found.card, drawn, readings, known)
    return [_one_again(one, found, again) for one, again in zip(readings, told, strict=True)]


def _one_again(one: Inspection, found: Basis, again: np.ndarray[Any, Any]) -> Replicated:
    labels = [one.id]
    if one.nodes is not None and one.values.ndim == 2:
        labels = [f"{one.id}[{node}].{axis}" for node in one.nodes for axis in "xyz"]
    unit = found.card.outputs[one.quantity].unit
    values = one.values.reshape(-1)
    return Replicated(one.blade, one.quantity, unit, one.time_h, labels, values, again)


def field_vtu(store: Store, science: Science, found: Basis, told: Mapping[str, Any]) -> bytes:
    """The answer of ``GET …/field`` on the model's mesh. NotFoundError: the model has none."""
    mesh = science.mesh(found.card)
    if mesh is None:
        remedy = "its runs gave the nodes no places (points): use format=json"
        raise NotFoundError("mesh of model", found.card.id, remedy)
    name, unit = told["quantity"], told["unit"]
    data = {f"{name} {what} [{unit}]": np.array(told[what]) for what in ("mean", "sd")}
    facts = {"blade": told["blade"], "quantity": name, "time_h": told["time_h"]} | facts_of(found)
    facts["held_from_h"] = json.dumps(told["held_from_h"])
    return vtu(mesh, data, float(told["time_h"]), facts)


def readings_csv(store: Store, log: Log, blade: str | None) -> Iterable[str]:
    """The readings that count, as CSV in pieces."""
    yield csv_header()
    for some in pages_of(store, log, blade):
        yield csv_text([one.body for one in some if one.status == "counts"])


def readings_parquet(store: Store, log: Log, blade: str | None) -> bytes:
    """Every reading with its status. Raises NotInstalledError where pyarrow is not there."""
    table = Parquet({"rotor": log.rotor, "model": log.model, "head_seq": str(log.head_seq)})
    for some in pages_of(store, log, blade):
        table.add((o.body, o.seq, o.status, o.received_at, o.posted_by) for o in some)
    return table.end()


def sensorthings(store: Store, log: Log, blade: str | None) -> Iterable[str]:
    """The readings that count, as SensorThings entities; the readings of one blade at a time."""
    with store.read() as tx:
        rotor = tx.records.rotor(log.rotor)
        network = tx.records.model(rotor.model_id, rotor.model_version).network
        blades = sorted(blades_of(tx, log.rotor), key=lambda one: one.id)

    def groups() -> Iterator[list[Json]]:
        for one in blades:
            if blade not in (None, one.id):
                continue
            counting = [
                (listed.body, moment(listed.received_at))
                for some in pages_of(store, log, one.id)
                for listed in some
                if listed.status == "counts"
            ]
            yield entities.datastreams(log.rotor, network, one, counting)

    return entities.text(groups())
