"""The study as one HTML file: every figure with the paper's statements about it beside ours.

No script and no other file: the style sheet is allowed by its digest, pictures are in the page.
All text comes from the study's numbers.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any

from core.validation.paper import CASES, THETA_SD
from service.report.markup import Markup, el, join
from service.report.page import style
from service.report.tables import facts, figure, pairs, section, table
from service.report.words import joined, number, with_sd
from service.studies.paper.densities import PSI, label_of
from service.studies.paper.plots import FIGURES
from service.studies.paper.statements import Judged

Json = Mapping[str, Any]
TITLE = "The paper's example, remade"
OWN_STYLE = Markup(
    "figure img{width:100%;height:auto;background:#fff;border:1px solid var(--rule)}"
    "blockquote{margin:.3rem 0;padding-left:.8rem;border-left:3px solid var(--rule);"
    "max-width:46rem}.said-here{margin:.6rem 0 1.1rem}.word,th,td:first-child{white-space:nowrap}"
)
KINDS = {"agrees": "adequate", "in part": "not-separable", "disagrees": "unattributed"}
CITED = (
    "Kapusuzoglu, Mahadevan, Matsumoto, Miyagi, Watanabe: Multi-Level Bayesian Calibration of a "
    "Multi-Component Dynamic System Model, J. Comput. Inf. Sci. Eng. 23(1) 011006 (2023), "
    "doi 10.1115/1.4055243, called the paper. Figures have the numbers of its Sec. 4."
)
NOTES = {
    "3": "The paper shows node 5057 of its own blade; here it is the critical node of this one.",
    "10": "Top: predicted mean and scan, every fourth node. Below: what is left at each node.",
    "16": "Each column: the scan that came next, foreseen from the outages before it.",
    "ceeq": "Each blade was cut up at its outage; beyond it the finite elements go on.",
}


def page(numbers: Json, found: Sequence[Judged], pictures: Mapping[str, Path]) -> str:
    """The page of a study's numbers, its statements and its figures by key."""
    digest = base64.b64encode(sha256((style() + OWN_STYLE).encode()).digest()).decode()
    policy = f"default-src 'none'; img-src data:; style-src 'sha256-{digest}'"
    parts = [
        _head(numbers, found),
        _summary(found),
        _data(numbers, found),
        *(_figure(one.key, one.title, found, pictures) for one in FIGURES if one.key in pictures),
        _parameters(numbers),
        _coverage(numbers),
        _schedule(numbers),
        _rests_on(numbers),
    ]
    whole = el(
        "html",
        el(
            "head",
            Markup('<meta charset="utf-8">'),
            Markup(f'<meta http-equiv="Content-Security-Policy" content="{policy}">'),
            Markup('<meta name="viewport" content="width=device-width,initial-scale=1">'),
            el("title", TITLE),
            el("style", Markup(style() + OWN_STYLE)),
        ),
        el("body", el("main", join([part for part in parts if part is not None]))),
        lang="en",
    )
    return f"<!doctype html>\n{whole}\n"


def _word(verdict: str) -> Markup:
    return el("span", verdict, class_=f"word {KINDS[verdict]}")


def _head(numbers: Json, found: Sequence[Judged]) -> Markup:
    count = {v: sum(one.verdict == v for one in found) for v in KINDS}
    t1t = numbers["cases"]["offline, without delta"][-1]["shown"]["t1t_rate"]
    held = numbers["cases"]["offline, without delta"][-1]["held"]
    told = [
        (" / ".join(str(count[v]) for v in KINDS), f"statements: {' / '.join(KINDS)}"),
        (with_sd(t1t["mean"], t1t["sd"]), f"T1T rate, elongations (truth {t1t['truth']:g})"),
        (f"{100 * held['inside_95']:.0f} %", f"of {held['readings']} held-out readings in 95 %"),
        (f"{number(numbers['seconds'])} s", "data to page"),
    ]
    return el(
        "header",
        el("h1", TITLE),
        el("p", CITED, class_="faint"),
        el(
            "p",
            "The data are finite elements with noise on a mesh that the surrogate never saw, by "
            "the plan of the paper's Table 1. The blades, their material and their finite elements "
            "are not the paper's, so numbers differ; what is compared is what the paper says of "
            "them. Posteriors are those of the joint target, not of the paper's Algorithm 1.",
        ),
        facts(told),
    )


def _summary(found: Sequence[Judged]) -> Markup:
    rows = [
        [
            one.statement.where,
            _figures(one.statement.figures),
            one.statement.quote,
            _word(one.verdict),
        ]
        for one in found
    ]
    return section(
        "What the paper says", table(("section", "figures", "the paper's words", "here"), rows)
    )


def _figures(numbers: Sequence[int]) -> str:
    return joined([str(n) for n in numbers]) or "–"


def _said(one: Judged) -> Markup:
    s = one.statement
    return el(
        "div",
        el("p", _word(one.verdict), " ", el("span", f"{s.where}, Fig. {_figures(s.figures)}")
           if s.figures else s.where),
        el("blockquote", f"“{s.quote}”"),
        el("p", one.ours),
        el("p", f"Rule: {s.rule}.", class_="note"),
        class_="said-here",
    )  # fmt: skip


def _data(numbers: Json, found: Sequence[Judged]) -> Markup:
    blades = f"{numbers['blades']} blades"
    rows = [
        ["elongation of the tip", blades, blades, blades],
        ["xyz deformation, 1,400 nodes", "blade 01", "blade 01", "blade 01"],
        ["CEEQ, critical node", "blade 28", "blade 82", "blade 99"],
    ]
    loose = [one for one in found if not one.statement.figures]
    return section(
        "Table 1: the data",
        table(("", "t1 = 8,000 h", "t2 = 16,000 h", "t3 = 24,000 h"), rows),
        el(
            "p",
            "As in the paper a blade that was cut up is replaced by a new one. Beyond the paper's "
            "plan all blades and blade 01's scan are held out at 32,000 h.",
        ),
        *(_said(one) for one in loose),
    )


def _figure(key: str, title: str, found: Sequence[Judged], pictures: Mapping[str, Path]) -> Markup:
    name = f"Figure {key}: {title}" if key.isdigit() else title
    data = base64.b64encode(pictures[key].read_bytes()).decode()
    image = Markup(f'<img alt="{el("b", name)[3:-4]}" src="data:image/png;base64,{data}">')
    own = [one for one in found if key.isdigit() and int(key) in one.statement.figures[:1]]
    note = NOTES.get(key, "")
    return section(name, figure(image, note), *(_said(one) for one in own))


def _parameters(numbers: Json) -> Markup:
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


def _coverage(numbers: Json) -> Markup:
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


def _schedule(numbers: Json) -> Markup | None:
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


def _rests_on(numbers: Json) -> Markup:
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
