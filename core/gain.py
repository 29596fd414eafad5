"""What multiplies the model stays well above zero, wherever its parameters lie in their priors.

A ``paper`` discrepancy multiplies the model by 1 + theta1 − theta2 psi, a bias ``times`` adds its
amplitude to that. Near zero a reading would say nothing of the blade, and below it the opposite.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import TYPE_CHECKING

from core.drift import Bias
from core.errors import InputError
from core.quantity import LEAST_GAIN, Quantity

if TYPE_CHECKING:
    from core.network import Network


def check_discrepancy(network: Network, quantity: Quantity) -> None:
    """1 + theta1 − theta2 psi of a ``paper`` discrepancy must stay above `LEAST_GAIN`."""
    theta, least = quantity.discrepancy.theta, 1 + least_paper(network, quantity)
    if least < LEAST_GAIN:
        raise InputError(
            f"discrepancy of {quantity.name}",
            (theta.low, theta.high),
            f"lets 1 + theta1 - theta2 psi fall to {least:.3g}, below {LEAST_GAIN}",
            "give theta a smaller sd",
        )


def check_biases(network: Network, quantity: Quantity) -> None:
    """Gains of the biases that may concern one reading, and a ``paper`` discrepancy's, add up
    to no less than `LEAST_GAIN`. (What a ``gp`` adds is known once there is a model.)"""
    own = [b for b in network.biases if b.how == "times" and b.quantity == quantity.name]
    if not own:
        return
    paper = least_paper(network, quantity) if quantity.discrepancy.kind == "paper" else 0.0
    total = 1 + paper + least_gain(own, network)
    if total < LEAST_GAIN:
        name = " + ".join(b.name for b in own)
        with_it = ", with the discrepancy," if paper else ""
        raise InputError(
            f"bias {name}",
            [(p.low, p.high) for p in (network.parameter(b.name).prior for b in own)],
            f"lets the gain{with_it} fall to {total:.3g}, below {LEAST_GAIN}",
            "narrow the amplitude",
        )


def least_paper(network: Network, quantity: Quantity) -> float:
    """The least theta1 − theta2 psi in the priors."""
    psi, theta = network.psi_of(quantity).prior, quantity.discrepancy.theta
    corners = [theta.low - t * p for t in (theta.low, theta.high) for p in (psi.low, psi.high)]
    return min(corners)


def least_gain(biases: Sequence[Bias], network: Network) -> float:
    """The least that biases ``times`` add to the gain of one reading, over their priors (≤ 0).

    A reading has one instrument, one campaign and one blade: of biases that name different ones of
    these only some add up.
    """
    least = 0.0
    readers = product(
        sorted({b.instrument for b in biases}, key=str),
        sorted({b.campaign for b in biases}, key=str),
        sorted({None, *(name for b in biases for name in b.blades or ())}, key=str),
    )
    for instrument, campaign, blade in readers:
        added = 0.0
        for b in biases:
            names = ((b.instrument, instrument), (b.campaign, campaign))
            if any(own not in (None, given) for own, given in names):
                continue
            if b.blades is not None and blade not in b.blades:
                continue
            prior = network.parameter(b.name).prior
            added += min(float(a * v) for a in (prior.low, prior.high) for v in b.shape.values)
        least = min(least, added)
    return least
