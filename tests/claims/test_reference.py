"""Our posteriors against stored reference posteriors (numpyro's NUTS; `core.validation.nuts`).

The files were made by ``bladetwin study reference``; nothing here needs numpyro but the test of the
target itself, which is skipped without it.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from core.calibration.message import BladeMessage
from core.calibration.online import update
from core.calibration.state import RotorState
from core.calibration.target import assemble, nominal, shared_space
from core.model import Model, rotor_blade
from core.observation import Inspection
from core.smc.particles import normalised
from core.validation.compare import Comparison, Stored, log_evidence, of_state
from core.validation.nuts import Target, diagnosed

FOLDER = Path(__file__).with_name("results") / "reference"
ROTORS = sorted(path.stem for path in FOLDER.glob("*.json"))


@lru_cache
def model() -> Model:
    return rotor_blade()


@lru_cache
def kept(name: str) -> Stored:
    return Stored.load(FOLDER / f"{name}.json")


@lru_cache
def calibrated(name: str) -> RotorState:
    return update(model(), kept(name).rotor, kept(name).readings)


def compared(name: str, state: RotorState) -> Comparison:
    return Comparison.of(of_state(model(), kept(name).rotor, state), kept(name).moments)
