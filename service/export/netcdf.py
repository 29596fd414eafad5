"""Draws as netCDF in ArviZ's schema (InferenceData; from ArviZ 1.0 on a DataTree).

    /posterior       dims (chain, draw[, blade]); a variable for each parameter: shared ones have
                     no blade; `units` and `level` are attributes of each
    /constant_data   known inputs of the blades, where the model has any; dims (blade)

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
from typing import Any

import h5netcdf
import h5py
import numpy as np
from numpy.typing import NDArray

from service.ports import JointDraws

Array = NDArray[np.float64]
Attributes = Mapping[str, str | int | float]


def inference_data(
    draws: JointDraws,
    units: Mapping[str, str],
    known: Mapping[str, Sequence[float]],
    facts: Attributes,
) -> bytes:
    """The file.

    units   of each parameter, and of each known input
    known   values of the known inputs, in the order of the blades; nan: not given
    facts   what the draws rest on
    """
    buffer = io.BytesIO()
    with h5netcdf.File(buffer, "w") as file:
        _attributes(file, facts)
        group = file.create_group("posterior")
        _attributes(group, facts)
        n = len(draws.shared)
        group.dimensions = {"chain": 1, "draw": n, "blade": len(draws.blades)}
        _numbers(group, "chain", ("chain",), np.arange(1))
        _numbers(group, "draw", ("draw",), np.arange(n))
        _names(group, "blade", draws.blades)
        places = plain((*draws.local_names, *draws.shared_names))
        for j, name in enumerate(draws.local_names):
            dims = ("chain", "draw", "blade")
            variable = _numbers(group, places[name], dims, draws.local[None, :, :, j])
            _attributes(variable, {"units": units[name], "long_name": name, "level": "local"})
        for j, name in enumerate(draws.shared_names):
            variable = _numbers(group, places[name], ("chain", "draw"), draws.shared[None, :, j])
            _attributes(variable, {"units": units[name], "long_name": name, "level": "shared"})
        if known:
            group = file.create_group("constant_data")
            _attributes(group, facts)
            group.dimensions = {"blade": len(draws.blades)}
            _names(group, "blade", draws.blades)
            for name, values in known.items():
                variable = _numbers(group, name, ("blade",), np.asarray(values, float))
                _attributes(variable, {"units": units[name], "long_name": name, "level": "known"})
    return buffer.getvalue()


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
    return "/" not in name and name == name.strip(" ") and name not in ("chain", "draw", "blade")


def _attributes(of: Any, told: Attributes) -> None:
    for name, value in told.items():
        of.attrs[name] = value


def _numbers(group: Any, name: str, dims: tuple[str, ...], data: NDArray[Any]) -> Any:
    return group.create_variable(name, dims, data=np.ascontiguousarray(data))


def _names(group: Any, name: str, values: Sequence[str]) -> None:
    text = h5py.string_dtype()
    group.create_variable(name, (name,), dtype=text, data=np.array(values, dtype=object))
