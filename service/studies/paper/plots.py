"""The figures of the paper's Sec. 4 from a study, under their numbers, and one of the CEEQ."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
from PIL import Image

from core.builtin.inspection_plan import SCANNED, Plan
from core.validation.paper import SHOWN, Strategy
from service.studies.paper.courses import ceeq, elongation, surrogate
from service.studies.paper.deformations import deformation
from service.studies.paper.densities import parameters
from service.studies.paper.run import Study
from service.studies.paper.sketch import network


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure of the paper, remade."""

    key: str
    title: str
    draw: Callable[[Study, Plan], Any]


_B90, _B01 = f"blade {int(SHOWN[1:])}", f"blade {int(SCANNED[1:]):02d}"


def _of_parameters(first: int, strategy: Strategy) -> list[Figure]:
    """Four figures from a number on: psi and hyperparameters, by elongations and by scans."""
    told = (
        (f"Posteriors of ψ, {_B90}, elongations, {strategy}", "multi", False),
        (f"Posteriors of σ and θ, elongations, {strategy}", "multi", True),
        (f"Posteriors of ψ, {_B01}, with its scans, {strategy}", "scanned", False),
        (f"Posteriors of σ and θ, scans, {strategy}", "scanned", True),
    )
    return [
        Figure(str(first + k), title, parameters(strategy, level, hyper=hyper))
        for k, (title, level, hyper) in enumerate(told)
    ]


FIGURES = (
    Figure("3", "Surrogate against finite elements at the critical node", surrogate),
    Figure("4", "The network and the order of calibration", lambda study, plan: network()),
    *_of_parameters(5, "offline"),
    Figure("9", f"Elongation of {_B90}, offline", elongation("offline")),
    Figure("10", f"Deformation of {_B01}, offline", deformation("offline")),
    *_of_parameters(11, "online"),
    Figure("15", f"Elongation of {_B90}, online", elongation("online")),
    Figure("16", f"Deformation of {_B01}, online", deformation("online")),
    Figure("ceeq", "CEEQ of the blades that were cut up, offline (not drawn in the paper)", ceeq),
)


def draw_all(study: Study, plan: Plan, folder: Path) -> dict[str, Path]:
    """Every figure as a PNG; their files by key."""
    folder.mkdir(parents=True, exist_ok=True)
    found = {}
    for one in FIGURES:
        figure, path = one.draw(study, plan), folder / f"figure-{one.key}.png"
        keep(figure, path)
        found[one.key] = path
    return found


def keep(figure: Any, path: Path) -> None:
    """A figure as a PNG of 256 colours, a third of the size."""
    with BytesIO() as whole:
        figure.savefig(whole, dpi=100, format="png")
        plt.close(figure)
        with Image.open(whole) as image:
            image.convert("RGB").quantize(256, dither=Image.Dither.NONE).save(path, optimize=True)
