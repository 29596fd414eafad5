"""A finished diagnosis as one file to hand on: HTML without a script and without any other file.

The style sheet stands in the file and is allowed by its digest; nothing else may be loaded. What
the page says comes from the diagnosis' JSON alone, so the same diagnosis gives the same bytes.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

from service.report import alternatives, evidence, noticed, residuals, sections, split
from service.report.conditions import conditions
from service.report.markup import Markup, el, join
from service.report.tables import facts, pairs, section
from service.report.verdict import do_next, verdict
from service.report.words import number, p_of

Json = Mapping[str, Any]
LAYOUT = 5  # raised when the page changes, so that its tag does


@cache
def style() -> Markup:
    """The style sheet."""
    return Markup(Path(__file__).with_name("style.css").read_text(encoding="utf-8"))


@cache
def policy() -> str:
    """The content security policy of a report: its own style sheet, and nothing else."""
    digest = base64.b64encode(sha256(style().encode()).digest()).decode()
    return f"default-src 'none'; style-src 'sha256-{digest}'; base-uri 'none'; form-action 'none'"


def report(
    found: Json, rotor: str, diagnosis: str, finished_at: str | None, limit: float | None = None
) -> str:
    """The page of a result of `core.diagnosis.to_json` with its `rests_on`.

    limit  of the quantity that is forecast [its unit]: by how much the remaining life moves
    """
    pictures = found.get("pictures") or {}
    units = {one["name"]: one["unit"] for one in pictures.get("amplitudes", ())}
    word = found["verdict"]
    title = f"Diagnosis of rotor {rotor}: {word}"
    head = el(
        "header",
        el("h1", f"Diagnosis of rotor {rotor}"),
        el("p", f"Diagnosis {diagnosis}, finished {finished_at or '–'}", class_="faint"),
        el("span", word, class_=f"word {word.replace(' ', '-')}"),
        el("p", verdict(found, rotor, units), class_="said"),
        el("p", do_next(found)),
        *_not_adopted(found),
        el("p", f"Why: {'; '.join(r.removesuffix('.') for r in found['reasons'])}.", class_="note"),
        _key_figures(found),
    )
    parts = [
        head,
        residuals.known(found),
        noticed.noticed(found),
        split.split(found),
        sections.effects(found),
        sections.before_after(found),
        conditions(found),
        sections.life(found, limit),
        sections.forecast(found),
        alternatives.alternatives(found),
        residuals.residuals(found),
        evidence.evidence(found),
        evidence.held(found),
        evidence.parameters(found),
        rests_on(found),
    ]
    page = el(
        "html",
        el(
            "head",
            Markup('<meta charset="utf-8">'),
            Markup(f'<meta http-equiv="Content-Security-Policy" content="{policy()}">'),
            Markup('<meta name="viewport" content="width=device-width,initial-scale=1">'),
            el("title", title),
            el("style", style()),
        ),
        el("body", el("main", join([p for p in parts if p is not None]))),
        lang="en",
    )
    return f"<!doctype html>\n{page}\n"


def _not_adopted(found: Json) -> list[Markup]:
    """Why a rotor that adopts what is named did not."""
    why = found.get("not_adopted")
    return [el("p", f"The rotor did not adopt it by itself: {why}")] if why else []


def _key_figures(found: Json) -> Markup:
    readings = found["readings"]
    told = [(f"{readings['used']} of {readings['delivered']}", "readings used of delivered")]
    if found["p"] is not None:
        told.append((p_of(found).removeprefix("= "), "p of the model as it was"))
    if found["p_after"] is not None and found["effects"]:
        told.append((number(found["p_after"], 2), "p of what is left"))
    if found["effects"]:
        whose = "" if found["claimed"] else ", by what is not claimed"
        told.append((f"{number(found['gained_nat'])} nat", f"log evidence gained{whose}"))
    if (compared := found["before_after"]) is not None:
        a, b = compared["before"]["rmse"], compared["after"]["rmse"]
        if a and b is not None:
            change = f"{100 * (b / a - 1):+z.0f} %".replace("-", "−")
            whose = "" if found["claimed"] else ", by the discrepancy"
            told.append((change, f"RMSE on readings not used{whose}"))
    return facts(told)


def rests_on(found: Json) -> Markup:
    """Readings, versions, digests, seed: what makes the same diagnosis again."""
    rests, readings = found["rests_on"], found["readings"]
    even = readings["used"] == readings["delivered"]
    used = f"{readings['used']} used of {readings['delivered']} delivered"
    told = [
        ("readings", used if even else f"{used}: NOT THE SAME"),
        ("rotor", rests["rotor"]),
        ("rotor's log", f"through entry {rests['through_seq']}"),
        ("digest of the readings", el("code", rests["events_digest"])),
        ("model", f"{rests['model']}, version {rests['model_version']}"),
        ("digest before", el("code", found["models"]["before"])),
        ("digest after", el("code", found["models"]["after"])),
        ("particles per blade", number(rests["particles"], 6)),
        ("seed", str(rests["seed"])),
    ]
    said = (
        "A function of these, of the rotor's name (by which random numbers are drawn), of its "
        "blades with their lots, and of what was asked: the same of them all give the same "
        "diagnosis. What of it was adopted, by somebody or by the rotor itself, stands in the "
        "rotor's log, not here."
    )
    return section("What it rests on", pairs(told), el("p", said, class_="note"))
