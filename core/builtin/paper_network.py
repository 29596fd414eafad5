"""The network of a rotor blade as the paper has it (Kapusuzoglu et al. 2023, Sec. 4 and Table 1).

::

    shared     T1T
    local      TBC thickness; alpha and gamma, standard deviates of primary and secondary creep
    measured   elongation; deformation, xyz at many nodes; CEEQ at a node

Priors of inputs are uniform, on the box of the shipped model's runs. Each quantity has a noise
sigma_obs that the rotor shares, log-uniform.
"""

from __future__ import annotations

from core.network import Network, Parameter, Quantity
from core.prior import Prior


def rotor_blade_network() -> Network:
    """The paper's network: T1T shared; TBC thickness, alpha and gamma local to each blade."""
    return Network(
        name="rotor-blade",
        parameters=(
            Parameter("tbc_thickness", "local", Prior("uniform", 2 / 3, 4 / 3), "1", "TBC"),
            Parameter("t1t_rate", "shared", Prior("uniform", 0.8, 1.0), "1", "T1T"),
            Parameter("creep_transient", "local", Prior("uniform", -3, 3), "1", "alpha"),
            Parameter("creep_steady", "local", Prior("uniform", -3, 3), "1", "gamma"),
        ),
        quantities=(
            # numerical: the default mesh against a refined one (tests/benchmarks/bench_blade.py)
            Quantity(
                "elongation",
                "mm",
                "scalar",
                Prior("log_uniform", 1e-3, 0.2),
                -5.0,
                50.0,
                numerical=0.003,
            ),
            Quantity(
                "deformation",
                "mm",
                "vector",
                Prior("log_uniform", 1e-3, 0.2),
                -50.0,
                50.0,
                numerical=0.003,
            ),
            Quantity(
                "ceeq",
                "1",
                "field",
                Prior("log_uniform", 1e-5, 1e-2),
                0.0,
                0.5,
                "critical",
                numerical=0.02,
            ),
        ),
        notes={"source": "Kapusuzoglu et al. 2023, doi 10.1115/1.4055243, Sec. 4 and Table 1"},
    )
