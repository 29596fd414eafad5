"""Draws as netCDF in ArviZ's schema (InferenceData; from ArviZ 1.0 on a DataTree).

    /posterior       dims (chain, draw[, blade]); a variable for each parameter: shared ones have
                     no blade; `units` and `level` are attributes of each
    /prior           as many draws of the same parameters from their priors
    /posterior_predictive
                     for each quantity that was read what its readings would be again under each
                     draw of the posterior; dims (chain, draw, <quantity>_reading)
    /observed_data   what they were; dims (<quantity>_reading). A scan has an entry for each node
                     and axis, ``id[node].axis``
    /particles       where it is asked for: the weighted particles themselves, before resampling;
                     dims (blade, particle): every parameter, `log_weight` (normalised for each
                     blade) and `node`, which of the rotor's shared nodes a particle hangs on
    /constant_data   known inputs of the blades, where the model has any; dims (blade); hours and
                     blade of each reading

The attributes of the file and of each group name what the draws rest on: rotor, version, digests
of state, readings and model, health. Draws are *equally weighted* and in random order: the
importance weights of the particles are spent by systematic resampling, so that means, sds and
intervals of `arviz.summary` are those of the posterior. Its ess, r_hat and mcse, which are meant
for Markov chains, are not about these particles: how well they carry the posterior stands in
`health`.

Written with h5netcdf alone, so that an API process loads neither xarray nor pandas for it.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import h5netcdf
import h5py
import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from service.ports import Draws, JointDraws

Array = NDArray[np.float64]
Attributes = Mapping[str, str | int | float]
_DIMENSIONS = ("chain", "draw", "blade", "particle")


@dataclass(frozen=True, slots=True)
class Replicated:
    """A reading and what it would be again: values (k,), again (n, k), labels of the k values."""

    blade: str
    quantity: str
    unit: str
    time_h: float
    labels: Sequence[str]
    values: Array
    again: Array


def inference_data(
    draws: JointDraws,
    units: Mapping[str, str],
    known: Mapping[str, Sequence[float]],
    facts: Attributes,
    *,
    prior: JointDraws | None = None,
    readings: Sequence[Replicated] = (),
    particles: Sequence[Draws] = (),
) -> bytes:
    """The file.

    units     of each parameter, and of each known input
    known     values of the known inputs, in the order of the blades; nan: not given
    facts     what the draws rest on
    prior     draws of the same parameters from their priors
    readings  on which the posterior rests
    particles weighted ones, of each blade in the order of the draws' blades
    """
    buffer = io.BytesIO()
    with h5netcdf.File(buffer, "w") as file:
        _attributes(file, facts)
        for name, drawn in (("posterior", draws), ("prior", prior)):
            if drawn is not None:
                _draws(_group(file, name, facts), drawn, units)
        if particles:
            _particles(_group(file, "particles", facts), particles, draws, units)
        if known or readings:
            constant = _group(file, "constant_data", facts)
        if known:
            constant.dimensions = {"blade": len(draws.blades)}
            _names(constant, "blade", draws.blades)
            for name, values in known.items():
                variable = _numbers(constant, name, ("blade",), np.asarray(values, float))
                _attributes(variable, {"units": units[name], "long_name": name, "level": "known"})
        if readings:
            again, observed = (
                _group(file, name, facts) for name in ("posterior_predictive", "observed_data")
            )
            again.dimensions = {"chain": 1, "draw": len(draws.shared)}
            _numbers(again, "chain", ("chain",), np.arange(1))
            _numbers(again, "draw", ("draw",), np.arange(len(draws.shared)))
            for quantity in sorted({one.quantity for one in readings}):
                own = [one for one in readings if one.quantity == quantity]
                _of_quantity(again, observed, constant, quantity, own)
    return buffer.getvalue()


def _group(file: Any, name: str, facts: Attributes) -> Any:
    group = file.create_group(name)
    _attributes(group, facts)
    return group


def _draws(group: Any, drawn: JointDraws, units: Mapping[str, str]) -> None:
    """Parameters: shared ones (chain, draw), local ones (chain, draw, blade)."""
    n = len(drawn.shared)
    group.dimensions = {"chain": 1, "draw": n, "blade": len(drawn.blades)}
    _numbers(group, "chain", ("chain",), np.arange(1))
    _numbers(group, "draw", ("draw",), np.arange(n))
    _names(group, "blade", drawn.blades)
    places = plain((*drawn.local_names, *drawn.shared_names))
    for j, name in enumerate(drawn.local_names):
        dims = ("chain", "draw", "blade")
        variable = _numbers(group, places[name], dims, drawn.local[None, :, :, j])
        _attributes(variable, {"units": units[name], "long_name": name, "level": "local"})
    for j, name in enumerate(drawn.shared_names):
        variable = _numbers(group, places[name], ("chain", "draw"), drawn.shared[None, :, j])
        _attributes(variable, {"units": units[name], "long_name": name, "level": "shared"})


def _particles(
    group: Any, particles: Sequence[Draws], draws: JointDraws, units: Mapping[str, str]
) -> None:
    """Weighted particles (blade, particle): parameters, log weights and nodes."""
    dims = ("blade", "particle")
    group.attrs["weights"] = "log_weight: of a blade's particles, normalised"
    group.dimensions = {"blade": len(draws.blades), "particle": len(particles[0].log_w)}
    _names(group, "blade", draws.blades)
    names = particles[0].names
    places = plain((*names, "log_weight", "node"))
    for j, name in enumerate(names):
        values = np.stack([own.values[:, j] for own in particles])
        level = "local" if name in draws.local_names else "shared"
        variable = _numbers(group, places[name], dims, values)
        _attributes(variable, {"units": units[name], "long_name": name, "level": level})
    log_w = np.stack([own.log_w for own in particles])
    log_w = log_w - logsumexp(log_w, axis=1, keepdims=True)
    _numbers(group, "log_weight", dims, log_w)
    _numbers(group, "node", dims, np.stack([own.node for own in particles]))


def _of_quantity(
    again: Any, observed: Any, constant: Any, quantity: str, readings: Sequence[Replicated]
) -> None:
    """The values of a quantity's readings, along a dimension of its own."""
    dim = f"{quantity}_reading"
    labels = [label for one in readings for label in one.labels]
    for group in (again, observed, constant):
        group.dimensions[dim] = len(labels)
        _names(group, dim, labels)
    drawn = np.concatenate([one.again for one in readings], axis=1)[None]
    values = np.concatenate([one.values for one in readings])
    for variable in (
        _numbers(again, quantity, ("chain", "draw", dim), drawn),
        _numbers(observed, quantity, (dim,), values),
    ):
        _attributes(variable, {"units": readings[0].unit, "long_name": quantity})
    hours = np.concatenate([np.full(len(one.values), one.time_h) for one in readings])
    _attributes(_numbers(constant, f"{quantity}_time_h", (dim,), hours), {"units": "h"})
    blades = [one.blade for one in readings for _ in one.labels]
    _names(constant, f"{quantity}_blade", blades, dim)


def plain(names: Sequence[str]) -> dict[str, str]:
    """Names that a netCDF variable may have: an instrument's name may hold a slash.

    >>> plain(["sigma_obs.elongation@a/b", "sigma_obs.elongation@a_b", "rate"])
    {'sigma_obs.elongation@a/b': 'sigma_obs.elongation@a_b_', 'sigma_obs.elongation@a_b': \
'sigma_obs.elongation@a_b', 'rate': 'rate'}
    """
    taken = {name for name in names if _is_plain(name)}
    found = {name: name for name in taken}
    for name in names:
        if name in found:
            continue
        made = name.replace("/", "_").strip(" ")
        while made in taken or not _is_plain(made):
            made += "_"
        taken.add(made)
        found[name] = made
    return {name: found[name] for name in names}


def _is_plain(name: str) -> bool:
    """Whether it is a netCDF name, and none of the dimensions."""
    return "/" not in name and name == name.strip(" ") and name not in _DIMENSIONS


def _attributes(of: Any, told: Attributes) -> None:
    for name, value in told.items():
        of.attrs[name] = value


def _numbers(group: Any, name: str, dims: tuple[str, ...], data: NDArray[Any]) -> Any:
    return group.create_variable(name, dims, data=np.ascontiguousarray(data))


def _names(group: Any, name: str, values: Sequence[str], dim: str | None = None) -> None:
    text = h5py.string_dtype()
    group.create_variable(name, (dim or name,), dtype=text, data=np.array(values, dtype=object))
