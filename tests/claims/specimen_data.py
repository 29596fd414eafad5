"""Measured creep curves of CMSX-6 at 980 °C, where they are on this machine, as readings.

BAM Reference Data, Ávila Calderón, Schriever, Han, Olbricht, Dolabella Portella & Skrotzki, doi
10.5281/zenodo.13937987, CC BY 4.0. Looked for in ``shared/data/cmsx6`` beside the project's folder,
or beside a folder above it.

Of the 1,428 readings count those up to the last one before a specimen first exceeds `LARGEST`
percent (the law knows no necking before rupture); of these every `EVERY`-th is posted, the first
one included. Nothing else is left out: 1,428 delivered, 1,359 up to 8 %, 276 used.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from core.builtin.creep_specimens import QUANTITY
from core.observation import Inspection

LARGEST, EVERY = 8.0, 5
PLACE = Path("shared", "data", "cmsx6", "creep_980C.csv")
MISSING = (
    f"no {PLACE} beside the project's folder: get 'BAM Reference Data: Creep of single-crystal "
    "Ni-based superalloy CMSX-6', doi 10.5281/zenodo.13937987"
)


@dataclass(frozen=True)
class Specimen:
    """A creep test: stress [MPa], and times [h] and strains [%] up to `LARGEST`."""

    name: str
    stress: float
    delivered: int
    time_h: NDArray[np.float64]
    strain: NDArray[np.float64]

    @property
    def readings(self) -> list[Inspection]:
        """Every `EVERY`-th one."""
        return self.every(EVERY)

    def every(self, step: int) -> list[Inspection]:
        """Every `step`-th one, the first included."""
        return [
            Inspection(f"{self.name}-{i}", self.name, QUANTITY, float(t), np.array([y]))
            for i, (t, y) in enumerate(zip(self.time_h, self.strain, strict=True))
            if i % step == 0
        ]


def found() -> Path | None:
    """The file, if it is here."""
    for folder in Path(__file__).resolve().parents[2].parents:
        if (folder / PLACE).exists():
            return folder / PLACE
    return None


@cache
def specimens() -> tuple[Specimen, ...]:
    """All twelve, by stress and name; skips the test that asks where they are not here."""
    path = found()
    if path is None:
        pytest.skip(MISSING)
    with path.open() as file:
        rows = list(csv.DictReader(file))
    out = []
    for name in {row["unit"] for row in rows}:
        own = [row for row in rows if row["unit"] == name]
        time_h, strain = (
            np.array([float(row[column]) for row in own])
            for column in ("time_h", "creep_extension_pct")
        )
        large = np.flatnonzero(strain > LARGEST)
        end = int(large[0]) if len(large) else len(own)
        out.append(
            Specimen(name, float(own[0]["stress_MPa"]), len(own), time_h[:end], strain[:end])
        )
    return tuple(sorted(out, key=lambda one: (one.stress, one.name)))
