"""Rotors whose blades are finite-element runs: a truth that is not the surrogate.

24 rotors of 20 blades. One t1t_rate per rotor, one in each of 24 equal slices of its prior, uniform
inside its slice, so that the rotors as a set are a stratified sample of the prior; local parameters
of every blade independently from their priors. Each blade is run on the mesh ``default``, on which
the surrogate was trained: what differs between truth and model is the surrogate's own error, not
the mesh's (0.3 % in elongation, which the network declares and the likelihood counts), so that
intervals should be a little wide where the noise is small.

Of each run little is kept: elongation and CEEQ at the critical node at all instants, and of each
rotor's first blade the deformation at some nodes of the outer skin, at the outages. Noise is added
by whoever uses the rotors; several noises on one rotor share its t1t_rate and its blades and are
not independent.

    bladetwin study rotors
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.blade import BOUNDS, BladeRun, build_mesh, output_times, run_campaign
from core.builtin.inspection_plan import scanned_nodes
from core.builtin.paper_network import rotor_blade_network
from core.builtin.rotor_blade import blade_digest
from core.errors import ModelError
from core.rng import stream

Array = NDArray[np.float64]
SHIPPED = Path(__file__).with_name("fe_rotors.npz")
SEED = 2001
ROTORS, BLADES = 24, 20
SCAN_H = (8_000.0, 16_000.0, 24_000.0, 32_000.0)
OUTAGES_H = (*SCAN_H, *(7_000.0 * k for k in range(1, 8)))
SCANNED = 300
Progress = Callable[[int, int], None]


def times() -> Array:
    """Instants of the runs [h]: the model's 54 and the outages of the studies."""
    return np.union1d(output_times(), OUTAGES_H)


@cache
def scan_nodes(count: int = SCANNED) -> NDArray[np.int64]:
    """`count` of the nodes a laser scanner reaches, evenly over their list."""
    nodes = scanned_nodes()
    return nodes[np.linspace(0, len(nodes) - 1, count).round().astype(np.int64)]


def design(seed: int = SEED, rotors: int = ROTORS, blades: int = BLADES) -> Array:
    """Inputs of all runs in the order of `BOUNDS`, (rotors, blades, 4).

    >>> x = design(rotors=5, blades=2)
    >>> sorted(int((rate - 0.8) / 0.04) for rate in x[:, 0, 1])
    [0, 1, 2, 3, 4]
    """
    network = rotor_blade_network()
    slices = stream(seed, "rotors").permutation(rotors)
    x = np.empty((rotors, blades, len(BOUNDS)))
    for r in range(rotors):
        rng = stream(seed, "rotor", r)
        for j, name in enumerate(BOUNDS):
            parameter = network.parameter(name)
            if parameter.level == "shared":
                place = np.full(blades, (slices[r] + rng.random()) / rotors)
            else:
                place = rng.random(blades)
            x[r, :, j] = parameter.prior.quantile(place)
    return x


def run(folder: str | Path, processes: int = 1, progress: Progress | None = None) -> Path:
    """The runs into small files of `folder`, rotor by rotor; a cut campaign goes on where it was.

    The folder's name for a set of runs holds the digest of the design and of the finite-element
    code: runs of another code are never mixed in. Raises ModelError where a run failed.
    """
    x = design().reshape(-1, len(BOUNDS))
    t, nodes = times(), scan_nodes()
    own = place(folder)
    own.mkdir(parents=True, exist_ok=True)
    at = np.searchsorted(t, SCAN_H)
    critical = build_mesh("default").named["critical"]

    def keep(index: int, done: BladeRun) -> None:
        arrays: dict[str, Any] = {
            "elongation": done.elongation,
            "ceeq": done.ceeq[:, critical].astype(np.float32),
        }
        if index % BLADES == 0:
            shift = done.displacement[at][:, nodes] - done.displacement[0][nodes]
            arrays["deformation"] = shift.astype(np.float32)
        part = own / f".{index:04d}.{os.getpid()}.npz"
        np.savez(part, **arrays)
        os.replace(part, own / f"{index:04d}.npz")

    campaign = run_campaign(
        [dict(zip(BOUNDS, map(float, point), strict=True)) for point in x],
        keep,
        mesh="default",
        done={int(file.stem) for file in own.glob("[0-9]*.npz")},
        processes=processes,
        progress=progress and (lambda done, total, left: progress(done, total)),
        time_h=t,
    )
    if campaign.failures:
        raise ModelError(f"run {campaign.failures[0].index}: {campaign.failures[0].reason}")
    return own


def place(folder: str | Path) -> Path:
    """Where the runs of this design and this code lie inside `folder`."""
    parts = (design(), times(), scan_nodes(), np.array(SCAN_H))
    text = b"".join(part.tobytes() for part in parts) + blade_digest().encode()
    return Path(folder) / f"rotors-{sha256(text).hexdigest()[:12]}"


def make(folder: str | Path, out: str | Path = SHIPPED) -> FERotors:
    """The whole rotors among the runs as one npz (elongation to 1e-7 mm, deformation to 1e-5)."""
    own, x = place(folder), design()
    files = [[own / f"{r * BLADES + b:04d}.npz" for b in range(BLADES)] for r in range(ROTORS)]
    whole = [r for r in range(ROTORS) if all(file.exists() for file in files[r])]
    if not whole:
        raise ModelError(f"{own} holds no whole rotor of {BLADES} runs: run the campaign first")
    runs = [[dict(np.load(file)) for file in files[r]] for r in whole]
    np.savez_compressed(
        out,
        seed=SEED,
        rotor=np.array(whole, dtype=np.int32),
        time_h=times(),
        inputs=x[whole],
        elongation=np.round([[run["elongation"] for run in rotor] for rotor in runs], 7),
        ceeq=np.array([[run["ceeq"] for run in rotor] for rotor in runs], dtype=np.float32),
        scan_nodes=scan_nodes().astype(np.int32),
        scan_h=np.array(SCAN_H),
        deformation=np.round([rotor[0]["deformation"] for rotor in runs], 5).astype(np.float32),
    )
    return load(out)


@dataclass(frozen=True)
class FERotors:
    """Truth without noise; R rotors of B blades, T instants.

    inputs (R, B, 4) in the order of `BOUNDS`; elongation (R, B, T) [mm]; ceeq (R, B, T) at the
    critical node; deformation (R, outages, nodes, 3) [mm] of each rotor's first blade
    """

    time_h: Array
    inputs: Array
    elongation: Array
    ceeq: Array
    scan_h: Array
    scan_nodes: NDArray[np.int64]
    deformation: Array

    def at(self, quantity: str, rotor: int, time_h: float) -> Array:
        """Elongation or CEEQ of a rotor's blades at one of the instants, (B,)."""
        k = np.flatnonzero(self.time_h == time_h)
        if not len(k):
            raise ModelError(f"{time_h:g} h is no instant of the finite-element rotors")
        return np.asarray(getattr(self, quantity)[rotor, :, k[0]], float)


def load(path: str | Path = SHIPPED) -> FERotors:
    """The shipped rotors."""
    try:
        with np.load(path, allow_pickle=False) as data:
            z = {name: data[name] for name in data.files}
    except OSError as error:
        raise ModelError(f"{path} holds no rotors: make them by bladetwin study rotors") from error
    return FERotors(
        z["time_h"],
        z["inputs"],
        z["elongation"],
        z["ceeq"].astype(float),
        z["scan_h"],
        z["scan_nodes"].astype(np.int64),
        z["deformation"].astype(float),
    )
