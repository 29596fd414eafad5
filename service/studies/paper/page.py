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

from service.report.markup import Markup, el, join
from service.report.page import style
from service.report.tables import facts, figure, section, table
from service.report.words import joined, number, with_sd
from service.studies.paper.plots import FIGURES
from service.studies.paper.statements import Judged
from service.studies.paper.tables import coverage, parameters, rests_on, schedule

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
        parameters(numbers),
        coverage(numbers),
        schedule(numbers),
        rests_on(numbers),
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
