"""The page's tables: parameters, coverage, the paper's Algorithm 1, and what all of it rests on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from core.validation.paper import CASES, THETA_SD
from service.report.markup import Markup, el, join
from service.report.tables import pairs, section, table
from service.report.words import number, with_sd
from service.studies.paper.densities import PSI, label_of

Json = Mapping[str, Any]


def parameters(numbers: Json) -> Markup:
    """Mean ± sd of blade 90's and blade 01's, offline, without and with δ, beside the truth."""
    parts = []
    for part, blade in (("shown", "blade 90, elongations"), ("scanned", "blade 01, with scans")):
        stages = [numbers["cases"][c.name][-1][part] for c in CASES if c.strategy == "offline"]
        rows = []
        for name in stages[1]:
            cells = [with_sd(s[name]["mean"], s[name]["sd"]) if name in s else "–" for s in stages]
            truth = stages[1][name]["truth"]
            rows.append([label_of(name), *cells, number(truth) if truth is not None else "–"])
        head = ("", "without δ", "with δ", "truth")
        parts += [el("h3", blade), table(head, rows, numeric=(1, 2, 3))]
    return section(
        "Parameters, offline: mean ± sd",
        *parts,
        el(
            "p",
            f"θ1 and θ2 have normal priors of sd {THETA_SD:g}, cut at four sds, and σ_δ = 1e-5 as "
            "in the paper; the paper gives no prior of θ. The readings have no δ of that form in "
            "them; what the model gets wrong is the surrogate's and the mesh's error.",
            class_="note",
        ),
    )


def coverage(numbers: Json) -> Markup:
    """Held-out elongations: error, foreseen sd, and how many of them the intervals hold."""
    rows = []
    for case in CASES:
        if case.strategy == "offline":
            held = numbers["cases"][case.name][-1]["held"]
            rows.append(
                [
                    "with δ" if case.delta else "without δ",
                    f"{1000 * held['rmse_mm']:.1f}",
                    f"{1000 * held['sd_mm']:.1f}",
                    f"{100 * held['inside_68']:.0f} %",
                    f"{100 * held['inside_95']:.0f} %",
                ]
            )
    head = ("", "error [µm]", "foreseen sd [µm]", "in 68 %", "in 95 %")
    return section(
        "Held-out elongations of all blades at 32,000 h", table(head, rows, numeric=(1, 2, 3, 4))
    )


def schedule(numbers: Json) -> Markup | None:
    """The paper's own Algorithm 1 beside the joint posterior, where it was run."""
    arms = numbers["schedule"]
    if not arms:
        return None
    rows = []
    for case in CASES:
        if case.name not in arms:
            continue
        arm, exact = arms[case.name], numbers["cases"][case.name][-1]["scanned"]
        cells = [with_sd(arm["scanned"][n]["mean"], arm["scanned"][n]["sd"]) for n in PSI]
        met = "met" if arm["converged"] else "not met"
        rows.append([case.name, *cells, f"{arm['sweeps']}, {met}", number(arm["cpu_s"])])
        cells = [with_sd(exact[n]["mean"], exact[n]["sd"]) for n in PSI]
        rows.append(["the joint posterior", *cells, "–", "–"])
    head = ("", *PSI.values(), "sweeps, threshold", "processor [s]")
    return section(
        "The paper's Algorithm 1 on the same readings: blade 01",
        table(head, rows, numeric=range(1, len(head))),
        el(
            "p",
            f"With {number(numbers['schedule_particles'])} particles a set. Its coverage on "
            "simulated rotors is in the study `bladetwin study schedule`.",
            class_="note",
        ),
    )


def rests_on(numbers: Json) -> Markup:
    """Command, commit, model, sizes, times, and the health of each state."""
    health = []
    for case in CASES:
        for stage in numbers["cases"][case.name]:
            own = [
                f"{step} {one['status']} (ESS {one['ess']:.0f} of {one['nodes']})"
                for step, one in stage["health"].items()
            ]
            health.append(f"{case.name}, t{stage['outages']}: {', '.join(own)}")
    size = f"{numbers['blades']}, {numbers['particles']}, {numbers['seed']}"
    load = ", ".join(str(v) for v in numbers["machine"]["load_when_begun"])
    spent = (
        f"{numbers['seconds']} in all, {numbers['calibration_s']} of them calibrations; "
        f"processor {numbers['cpu_s']}"
    )
    told = [
        ("command", el("code", numbers["command"])),
        ("commit", el("code", numbers["commit"] or "–")),
        ("model", el("code", numbers["model"])),
        ("blades, particles, seed", size),
        ("processes, processors", f"{numbers['processes']}, {numbers['machine']['processors']}"),
        ("load when begun (1, 5, 15 min)", load),
        ("seconds", spent),
        ("health of each state", join([el("div", one) for one in health])),
    ]
    return section("What it rests on", pairs(told))
