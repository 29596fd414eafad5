"""Units of parameters by their names in a posterior."""

from __future__ import annotations

from core.errors import InputError
from core.network import Network


def unit_of(network: Network, name: str) -> str:
    """The unit of a parameter of a posterior, whether declared or made by the calibration.

    A population's mean and sd have their parameter's unit, a noise its quantity's, a constant
    discrepancy as well; theta1, theta2 and modes in time are factors. The amplitude of an effect
    that is added has the unit of its input or quantity.

    >>> from core.builtin.paper_network import rotor_blade_network
    >>> network = rotor_blade_network()
    >>> [unit_of(network, n) for n in ("t1t_rate", "sigma_obs.elongation@gauge 3", "sd.t1t_rate")]
    ['1', 'mm', '1']
    """
    head, _, rest = name.partition(".")
    if head in ("mean", "sd") and rest:
        return unit_of(network, rest)
    if head == "sigma_obs" and rest:
        return network.quantity(rest.partition("@")[0]).unit
    if head == "theta" and rest:
        quantity = network.quantity(rest.partition(".")[0])
        return quantity.unit if quantity.discrepancy.kind == "constant" else "1"
    if head in ("theta1", "theta2") and rest:
        return "1"
    try:
        return network.unit_of(name)
    except InputError:
        return ""
