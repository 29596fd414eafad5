"""What a model says before and after its readings, draw by draw.

A prior draw of a rotor is drawn from the top of the network: shared parameters from their priors,
then each blade's own ones, from their populations where these are declared. A replicated reading is
what the same instrument would read again, at the same hour and node, if a draw (l_b, s) were true:

    y_rep = g Y_m(t; l_b, s) + o + sqrt(g² (s_m² + nu² Y_m²) + sigma_delta² + (r g Y_m)² + sigma²) z

with z ~ N(0, 1) for each draw and value, the surrogate's mean Y_m and sd s_m, the quantity's
numerical error nu, gain g, offset o, sigma_delta and r of discrepancy and biases
(`core.discrepancy`), and the reading's own sigma, or the draw's: what the likelihood assumes. The
values of a scan are drawn each by itself, though the surrogate's error goes through all of them.

The streams are fixed: the same draws give the same ones.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from core.calibration.state import Posterior
from core.curves import corrected, inputs_of, noise_of
from core.model import Model
from core.network import Network
from core.observation import Inspection
from core.prior import Prior, cut_quantile
from core.rng import stream
from core.smc.particles import Particles
from service.ports import JointDraws

Array = NDArray[np.float64]
Key = tuple[str, str, tuple[int, ...] | None]


def prior_draws(network: Network, shared: Mapping[str, Prior], like: JointDraws) -> JointDraws:
    """As many draws of the same parameters and blades, from their priors.

    shared   the prior of each shared parameter of `like`
    """
    n = len(like.shared)
    strata = {name: _strata(n, "shared", name) for name in like.shared_names}
    s = {name: shared[name].quantile(level) for name, level in strata.items()}
    local = np.empty_like(like.local)
    for i, blade in enumerate(like.blades):
        for j, name in enumerate(like.local_names):
            parameter, level = network.parameter(name), _strata(n, "local", blade, name)
            prior = parameter.prior
            if parameter.population is None:
                local[:, i, j] = prior.quantile(level)
                continue
            mean, sd = (
                s[of] if of in s else own.quantile(_strata(n, "shared", of))
                for of, own in parameter.hyperparameters.items()
            )
            local[:, i, j] = cut_quantile(level, mean, sd, prior.low, prior.high)
    columns = [s[name] for name in like.shared_names]
    values = np.stack(columns, axis=1) if columns else np.empty((n, 0))
    return JointDraws(like.shared_names, values, like.local_names, like.blades, local, n)


def _strata(n: int, *of: str) -> Array:
    """n even levels of a distribution in random order, one in each n-th of it."""
    rng = stream(0, "prior draws", n, *of)
    return np.asarray((rng.permutation(n) + rng.random(n)) / n)


def replicated(
    model: Model,
    drawn: JointDraws,
    readings: Sequence[Inspection],
    known: Mapping[str, Mapping[str, float]],
) -> list[Array]:
    """What each reading would be again under each draw: (n, k) for one of k values."""
    groups: dict[Key, list[int]] = {}
    for i, one in enumerate(readings):
        nodes = None if one.nodes is None else tuple(one.nodes.tolist())
        groups.setdefault((one.blade, one.quantity, nodes), []).append(i)
    found: list[Array] = [np.empty(0)] * len(readings)
    for (blade, quantity, nodes), places in groups.items():
        own = model.for_blade(blade)
        posterior = _of_blade(drawn, blade)
        declared = own.network.quantity(quantity)
        hours = np.array([readings[i].time_h for i in places])
        asked = nodes
        if asked is None and declared.kind != "scalar":
            asked = (declared.node_among(own.part(quantity).named),)
        x = inputs_of(own, posterior, quantity, known.get(blade))
        order = np.unique(hours, return_inverse=True)
        mean, sd = own.part(quantity).predict(
            x, quantity, order[0], None if asked is None else list(asked)
        )
        for i, at in zip(places, order[1], strict=True):
            shape = (len(x), -1, 3 if declared.kind == "vector" else 1)
            y, error = mean[:, at].reshape(shape), sd[:, at].reshape(shape)
            found[i] = _again(own, posterior, readings[i], y, error)
    return found


def _of_blade(drawn: JointDraws, blade: str) -> Posterior:
    psi = np.hstack([drawn.local[:, drawn.blades.index(blade)], drawn.shared])
    return Posterior((*drawn.local_names, *drawn.shared_names), Particles(psi, np.zeros(len(psi))))


def _again(model: Model, posterior: Posterior, one: Inspection, y: Array, error: Array) -> Array:
    """One reading under each draw, (n, k), of the surrogate's mean and sd (n, nodes, axes)."""
    declared = model.network.quantity(one.quantity)
    reader, time = (one.instrument, one.campaign), np.array([one.time_h])
    if one.sigma is None:
        sigma = noise_of(model, posterior, one.quantity, one.instrument)
    else:
        sigma = np.full(len(y), one.sigma)
    again = np.empty_like(y)
    for axis in range(y.shape[2]):
        component = axis if declared.kind == "vector" else None
        gain, offset, sigma_delta, left = corrected(
            model, posterior, declared, time, component, reader
        )
        centre = gain * y[:, :, axis]
        variance = (gain * error[:, :, axis]) ** 2 + (declared.numerical * centre) ** 2
        variance += sigma_delta**2 + (left * centre) ** 2 + sigma[:, None] ** 2
        z = stream(0, "replicated", len(y), one.id, axis).standard_normal(centre.shape)
        again[:, :, axis] = centre + offset + np.sqrt(variance) * z
    return again.reshape(len(y), -1)
