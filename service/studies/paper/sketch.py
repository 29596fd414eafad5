"""The paper's Fig. 4 as this network has it: who depends on whom, and the order of calibration."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt

from service.studies.plots import BAND, INK

SOFT, DATA = "#eef1f5", "#dfead9"
Box = tuple[float, float, str, str]  # middle, words, colour
PLACES: dict[str, Box] = {
    "t1t": (0.12, 0.88, "T1T\n(shared)", BAND),
    "local": (0.12, 0.55, "TBC thickness, α, γ\n(of each blade)", BAND),
    "model": (0.45, 0.72, "surrogate of the\nfinite elements", SOFT),
    "elongation": (0.8, 0.9, "elongation\n100 blades, t1 t2 t3", DATA),
    "deformation": (0.8, 0.6, "deformation\nblade 01, t1 t2 t3", DATA),
    "ceeq": (0.8, 0.3, "CEEQ\nblades 28, 82, 99", DATA),
    "delta": (0.45, 0.3, "δ (θ1, θ2) and noise σ,\nof each quantity (shared)", BAND),
}
ARROWS = (
    ("t1t", "model"),
    ("local", "model"),
    *(("model", q) for q in ("elongation", "deformation", "ceeq")),
    *(("delta", q) for q in ("elongation", "deformation", "ceeq")),
    ("t1t", "delta"),
)
STEPS: dict[str, Box] = {
    "1": (0.5, 0.92, "1  priors", SOFT),
    "2": (0.5, 0.65, "2  elongations of all blades:\nψ of each, T1T, σ¹, θ¹", BAND),
    "3": (0.25, 0.3, "3  scans of blade 01:\nψ again, σ², θ²", DATA),
    "4": (0.75, 0.3, "4  CEEQ of 28, 82, 99:\nψ again, σ³, θ³", DATA),
}
STEP_ARROWS = (("1", "2"), ("2", "3"), ("2", "4"))


def network() -> Any:
    """(a) the network, (b) the steps of Sec. 4.3."""
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(11, 4.0), width_ratios=(1.5, 1), layout="constrained"
    )
    _sketch(left, PLACES, ARROWS, "(a) network")
    _sketch(right, STEPS, STEP_ARROWS, "(b) order of calibration")
    right.text(
        0.5, 0.06, "offline: all outages at once\nonline: the same after each outage",
        ha="center", va="center", fontsize=8.5, color=INK,
    )  # fmt: skip
    return figure


def _sketch(
    axis: Any, places: dict[str, Box], arrows: tuple[tuple[str, str], ...], title: str
) -> None:
    axis.set_xlim(-0.06, 1.02)
    axis.set_ylim(0, 1.02)
    axis.axis("off")
    axis.set_title(title, fontsize=9.5, loc="left")
    shown = {
        name: axis.text(
            x, y, words, ha="center", va="center", fontsize=8.5, zorder=3,
            bbox={"boxstyle": "round,pad=0.45", "fc": colour, "ec": INK, "lw": 0.9},
        )
        for name, (x, y, words, colour) in places.items()
    }  # fmt: skip
    for start, end in arrows:
        axis.annotate(
            "",
            xy=places[end][:2],
            xytext=places[start][:2],
            arrowprops={
                "arrowstyle": "-|>", "color": INK, "lw": 0.9,
                "patchA": shown[start].get_bbox_patch(), "patchB": shown[end].get_bbox_patch(),
            },
            zorder=2,
        )  # fmt: skip
