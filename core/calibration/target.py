"""The joint target, blade by blade: readings packed as rows for the compiled messages.

A blade's rows are polynomials of the model's inputs (`core.response`), scaled to the boxes of the
priors; each row has a reading and a noise, which is a shared parameter sigma_obs of its quantity
or, where the inspection says so, known. A normal prior of a local parameter is one more row,
linear in it.

A 3-D scan of thousands of nodes is no thousand independent facts about four inputs. With the
deformation modes Phi at the scanned nodes and Phi = Q R, the readings y split into Q^T y, which
depends on the inputs through R c(t; x) E(t; x), and a remainder that depends on the noise only:

    p(y | x) = N(Q^T y | R c E, sigma² I + R C R^T s(x)²)
               · (2 pi sigma²)^(−nu/2) exp(−RSS / 2 sigma²)

C is the covariance of the surrogate's error in mode space. Rotating by the eigenvectors of
R C R^T makes every row independent, so a scan is exact in a dozen rows, and its precision is
limited by what the surrogate knows, not by the number of nodes. Rotated rows in which the prior's
whole range moves the reading by less than a tenth of its noise are left to the remainder.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from core.errors import InputError
from core.model import Model
from core.network import Parameter, Prior
from core.observation import Inspection, digest_of
from core.response import Response, multi_indices

Array = NDArray[np.float64]
DEGREE = 5


@dataclass(frozen=True, slots=True)
class Dense:
    """Remainder of a scan: residual sum of squares [unit²] and its degrees of freedom."""

    sigma: str | float
    rss: float
    dof: int


@dataclass(frozen=True, slots=True)
class BladeRows:
    """A blade's readings, packed.

    response  R rows over all inputs, on the priors' boxes
    y         readings, (R,)
    sigma     per row: the name of a shared sigma_obs, or a known value
    dense     remainders of scans
    digest    of the readings
    """

    response: Response
    y: Array
    sigma: tuple[str | float, ...]
    dense: tuple[Dense, ...]
    digest: str

    @property
    def shared_sigmas(self) -> tuple[str, ...]:
        names = [s for s in (*self.sigma, *(d.sigma for d in self.dense)) if isinstance(s, str)]
        return tuple(sorted(set(names)))


@dataclass(frozen=True, slots=True)
class SharedSpace:
    """The shared parameters as a unit box: physical ones first, then the noise of each quantity."""

    names: tuple[str, ...]
    priors: tuple[Prior, ...]

    @property
    def dim(self) -> int:
        return len(self.names)

    def to_x(self, unit: Array) -> Array:
        """Unit box (n, d) → natural values."""
        out = np.empty_like(unit)
        for j, prior in enumerate(self.priors):
            low, high = prior.box
            out[:, j] = prior.to_x(low + unit[:, j] * (high - low))
        return out

    def log_prior(self, unit: Array) -> Array:
        """Log density with respect to the unit box, (n,)."""
        total = np.zeros(len(unit))
        for j, prior in enumerate(self.priors):
            low, high = prior.box
            total += prior.log_density_u(low + unit[:, j] * (high - low)) + math.log(high - low)
        return total


def shared_space(model: Model, rows: Iterable[BladeRows]) -> SharedSpace:
    """Shared parameters that the readings can speak of; a noise nobody measured keeps its prior."""
    physical = model.network.of_level("shared")
    met = {name for r in rows for name in r.shared_sigmas}
    noises = [q for q in model.network.quantities if q.sigma_name in met]
    return SharedSpace(
        (*(p.name for p in physical), *(q.sigma_name for q in noises)),
        (*(p.prior for p in physical), *(q.sigma_obs for q in noises)),
    )


def _boxed(model: Model, response: Response) -> Response:
    """Rows on the boxes of the priors (known and dormant inputs keep the surrogate's)."""
    low, high = response.low.copy(), response.high.copy()
    for j, name in enumerate(response.names):
        parameter = model.network.parameter(name)
        if parameter.level in ("local", "shared"):
            if parameter.prior.log_scale:
                raise InputError(
                    f"prior of {name}",
                    "log_uniform",
                    "cannot be calibrated as an input",
                    "train the surrogate on its logarithm and declare that, uniform",
                )
            low[j], high[j] = parameter.prior.low, parameter.prior.high
    return response.reboxed(low, high)


def _rows(model: Model, key: tuple[object, ...], make: object) -> Response:
    """Responses are asked for again and again at the same outages: keep them with the model."""
    if key not in model._rows:
        if len(model._rows) > 4096:
            model._rows.clear()
        model._rows[key] = _boxed(model, make())  # type: ignore[operator]
    return model._rows[key]


def _node_of(model: Model, reading: Inspection) -> list[int] | None:
    quantity = model.network.quantity(reading.quantity)
    if quantity.kind == "scalar":
        return None
    if reading.nodes is not None:
        return [int(n) for n in reading.nodes]
    return [model.surrogate.named[quantity.node or "critical"]]


def _scan(model: Model, reading: Inspection) -> tuple[Response, Array, Dense]:
    """A 3-D scan as independent rows and a remainder."""
    quantity = model.network.quantity(reading.quantity)
    nodes = reading.nodes
    assert nodes is not None
    phi = model.surrogate.deformation_modes(nodes.tolist()).reshape(reading.values.size, -1)
    q, r = np.linalg.qr(phi)
    y = reading.values.reshape(-1)
    z = q.T @ y
    covariance = model.surrogate.mode_covariance(reading.time_h)
    _, turn = np.linalg.eigh(r @ covariance @ r.T)
    key = ("scan", reading.quantity, reading.time_h, nodes.tobytes())
    response = _rows(
        model, key, lambda: model.surrogate.mode_response(reading.time_h, turn.T @ r, degree=DEGREE)
    )
    z = turn.T @ z
    noise = reading.sigma or math.exp(0.5 * sum(quantity.sigma_obs.box))
    mean, sd = response.evaluate(
        response.low
        + (response.high - response.low)
        * np.random.default_rng(0).random((256, len(response.names)))
    )
    speaks = np.ptp(mean, axis=0) > 0.1 * np.sqrt(noise**2 + np.median(sd, axis=0) ** 2)
    if not speaks.any():
        speaks[np.argmax(np.ptp(mean, axis=0))] = True
    rest = z[~speaks] - np.median(mean[:, ~speaks], axis=0)
    rss = float(y @ y - (q.T @ y) @ (q.T @ y)) + float(rest @ rest)
    kept = Response(
        response.names,
        response.low,
        response.high,
        response.degree,
        response.a[speaks],
        response.b[speaks],
        response.ka[speaks],
        response.kb[speaks],
        response.log_v[speaks],
    )
    sigma = reading.sigma if reading.sigma is not None else quantity.sigma_name
    return kept, z[speaks], Dense(sigma, max(rss, 0.0), y.size - int(speaks.sum()))


def _gaussian_prior_rows(model: Model, like: Response) -> list[tuple[Response, float, float]]:
    """A row (response, mean, sd) for each local parameter with a normal prior."""
    found = []
    for j, name in enumerate(like.names):
        parameter = model.network.parameter(name)
        if parameter.level == "local" and parameter.prior.kind == "normal":
            half = 0.5 * (like.high[j] - like.low[j])
            a = np.zeros((1, like.a.shape[1]))
            a[0, 0] = like.low[j] + half
            unit = np.zeros(len(like.names), dtype=np.int64)
            unit[j] = 1
            table = multi_indices(len(like.names), like.degree)
            a[0, np.flatnonzero((table == unit).all(axis=1))[0]] = half
            zero = np.zeros((1, like.a.shape[1]))
            row = Response(
                like.names,
                like.low,
                like.high,
                like.degree,
                a,
                zero,
                np.zeros(1),
                np.zeros(1),
                zero,
            )
            found.append((row, parameter.prior.mean, parameter.prior.sd))
    return found


def assemble(model: Model, readings: Sequence[Inspection]) -> BladeRows | None:
    """The rows of one blade; None where it has no reading."""
    if not readings:
        return None
    parts: list[Response] = []
    y: list[Array] = []
    sigma: list[str | float] = []
    dense: list[Dense] = []
    for reading in sorted(readings, key=lambda i: (i.time_h, i.id)):
        quantity = model.network.quantity(reading.quantity)
        if quantity.kind == "vector":
            response, values, rest = _scan(model, reading)
            dense.append(rest)
        else:
            nodes = _node_of(model, reading)
            times = np.array([reading.time_h])
            key = (reading.quantity, reading.time_h, None if nodes is None else tuple(nodes))
            response = _rows(
                model,
                key,
                lambda q=reading.quantity, t=times, n=nodes: model.surrogate.response(
                    q, t, n, degree=DEGREE
                ),
            )
            values = reading.values
        parts.append(response)
        y.append(values)
        name = reading.sigma if reading.sigma is not None else quantity.sigma_name
        sigma += [name] * len(response)
    for row, mean, sd in _gaussian_prior_rows(model, parts[0]):
        parts.append(row)
        y.append(np.array([mean]))
        sigma.append(sd)
    return BladeRows(
        Response.stack(parts), np.concatenate(y), tuple(sigma), tuple(dense), digest_of(readings)
    )


def locals_of(model: Model) -> tuple[Parameter, ...]:
    """Local parameters that are inputs of the surrogate, in the surrogate's order."""
    names = [n for n in model.input_names if model.network.parameter(n).level == "local"]
    return tuple(model.network.parameter(n) for n in names)


def nominal(model: Model, given: Mapping[str, float] | None = None) -> dict[str, float]:
    """Values of the inputs that are not calibrated: known ones as given, the rest nominal."""
    out = {}
    for name in model.input_names:
        parameter = model.network.parameter(name)
        if parameter.level in ("known", "dormant"):
            value = (given or {}).get(name, parameter.nominal)
            if value is None:
                raise InputError(name, None, "is known for no blade", "give it with the blade")
            out[name] = value
    return out
