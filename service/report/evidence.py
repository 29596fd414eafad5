"""The sections on what was tried: evidence, p-values, what held, parameters, what would split."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from service.report import figures
from service.report.alternatives import hypothesis
from service.report.markup import Child, Markup, el
from service.report.sections import ALARM, ALLOWED, CONFIRMED, LEFT, NAMED, OLDER, SHOWN, changes
from service.report.tables import cell, figure, note, section, table
from service.report.words import joined, number, p_of, with_sd

Json = Mapping[str, Any]


def evidence(found: Json) -> Markup:
    """Shares of the evidence by name, calibrated hypotheses, p-values, and everything tried."""
    parts: list[Child] = []
    rows = [("of the model as it was", found["p"], ALARM)] if found["p"] is not None else []
    if found["p_after"] is not None and found["effects"]:  # else nothing was put in
        rows.append(("of what is left after", found["p_after"], LEFT))
    if rows:
        said = "Family-wise over everything that was tried; the null is made of the residuals."
        if found["p"] is not None and p_of(found).startswith("≤"):
            said += (
                f" {number(found['p'], 2)} is the least that {found['dealt']} dealt sets can tell."
            )
        parts.append(figure(figures.p_values(rows), said))
    shares = [(n, 100 * w) for n, w in found["evidence"].items() if w is not None and w >= 5e-3]
    if shares:
        said = "Share of the evidence of all hypotheses with that name in them."
        drawn = figures.bars("Share of the evidence", "[%]", shares[:SHOWN], share=True)
        parts.append(figure(drawn, said))
    calibrated = [
        (hypothesis(one), one["gained_nat"])
        for one in found["calibrated"]
        if one["gained_nat"] is not None
    ]
    if calibrated:
        said = "Calibrated with the effect in the model: log evidence against the model as it was."
        drawn = figures.bars("Log evidence gained", "[nat]", calibrated, share=False)
        parts.append(figure(drawn, said))
    for one in found["no_room"]:
        parts.append(note(f"{joined(one['names'])} could not be calibrated: {one['why']}"))
    parts += _tried(found)
    return section("Evidence, and everything that was tried", *parts)


def _tried(found: Json) -> list[Child]:
    every = found["tried"]
    if not every:
        return [note("This twin tries no grammar of effects.")]
    said = f"All {len(every)} families and whom, by the log of their mean Bayes factor [nat]:"
    items = [el("li", f"{number(one['log_bf'])}: {_what(one['what'])}") for one in every]
    return [el("h3", "Everything tried"), el("p", said), el("ol", *items, class_="tried")]


def _what(name: str) -> str:
    return f"a misfit of any course {name}" if name.startswith("by ") else name


def held(found: Json) -> Markup:
    """Whether effects hold between halves of the blades, and early and late."""
    title = "What held"
    if not found["holds"]:
        nothing = el("p", "No amplitude was held against itself.")
        return section(title, nothing, *placebos(found), *concerned(found))
    rows: list[list[Child]] = []
    for one in found["holds"]:
        a, b = one["amplitudes"]
        word, kind = "agrees", "better"
        if not one["agrees"]:
            word, kind = "does not agree", "mark"
        if one.get("gained_nat"):
            first, second = one["gained_nat"]
            word += f"; the halves by themselves gain {first:z.1f} and {second:z.1f} nat"
            kind = "mark" if not (one["agrees"] and one["stands"]) else "better"
        what = [one.get("effect", ""), one["by"]]
        rows.append([*what, number(a), number(b), number(one["sd"]), cell(word, kind=kind)])
    head = ["", "", "one half", "the other", "sd of the difference", ""]
    said = (
        "Amplitudes in multiples of the expected size; they agree within three sd. Where a large "
        f"one does not, each half by itself has to have each effect by {CONFIRMED:g} nat."
    )
    shown = [table(head, rows, (2, 3, 4)), note(said)]
    return section(title, *shown, *placebos(found), *concerned(found))


def placebos(found: Json) -> list[Child]:
    """The effects where they are not: how often they gain as much; nothing in older reports."""
    rows: list[list[Child]] = []
    for one in found.get("placebos", ()):
        word, kind = ("few", "better") if one["stands"] else ("too many", "mark")
        if one["stands"] and one["won"] > ALLOWED * one["count"]:
            word = "not told: the scan hardly sees the effect"
        share = f"{one['won']} of {one['count']}"
        gains = [f"{one[name]:.1f}" for name in ("gained_nat", "best_nat")]
        rows.append([one["effect"], one["by"], share, *gains, cell(word, kind=kind)])
    if not rows:
        return []
    head = ["", "given to", "gain as much", "effect [nat]", "best placebo [nat]", ""]
    said = (
        "The same effect at other blades (or the other way round in half of them), and at other "
        "readings of the same blades, drawn at random. Where more than "
        f"{ALLOWED:.0%} of these gain as much as the effect, nothing is claimed. Gains are the "
        "scan's."
    )
    return [table(head, rows, (2, 3, 4)), note(said)]


def concerned(found: Json) -> list[Child]:
    """Whether all blades that effects are said of have them; nothing in older reports."""
    rows: list[list[Child]] = []
    for one in found.get("concerns", ()):
        word, kind = "all", "better"
        if not one["stands"]:
            word, kind = ("some", "mark") if one["all"] <= 1.0 - NAMED else ("open", "mark")
        if_some = f"{100 * one['share']:.0f}"
        numbers = [str(one["blades"]), number(100 * one["all"]), if_some, number(one["some_nat"])]
        rows.append([one["effect"], *numbers, cell(word, kind=kind)])
    if not rows:
        return []
    head = ["", "blades", "all have it [%]", "if some: of them [%]", "some against all [nat]", ""]
    said = (
        "Whether each effect is in all blades that it is said of, or in some that nobody knows. "
        f"It is claimed where all have {NAMED:.0%} of the evidence; beforehand they are ten times "
        "as likely."
    )
    return [table(head, rows, (1, 2, 3, 4)), note(said)]


def parameters(found: Json) -> Markup:
    """Parameters before and after, with a mark at those that lean on a bound."""
    pictures, title = found.get("pictures"), "Parameters before and after"
    rows: list[list[Child]] = []
    if not pictures:
        told = found["parameters"]
        for name in {**told["before"], **told["after"]}:
            rows.append([name, *(_plain(told[w].get(name)) for w in figures.BOTH)])
        if not rows:
            return section(title, el("p", "None are kept."))
        return section(title, table(["shared parameter", "before", "after"], rows, (1, 2)),
                       note(OLDER.format("bounds")))  # fmt: skip
    for one in pictures["parameters"]:
        unit = "" if one["unit"] == "1" else f" [{one['unit']}]"
        name = f"{one['name']}{unit}" + (", of the blades" if one["level"] == "local" else "")
        if one["effect"]:
            name += " (the effect)"
        a, b = (one[w] for w in figures.BOTH)
        both = [(a, "before"), (b, "after")] if changes(found) else [(a, "")]
        marks = [said for own, which in both if (said := _mark(own, which))]
        span = f"{number(one['low'])} … {number(one['high'])}"
        rows.append(
            [name, *(_plain(own) for own, _ in both), span, cell("; ".join(marks), kind="mark")]
        )
    said = (
        "Of a local parameter: the mean over the blades ± the sd of a single blade. A mark says "
        "that the posterior leans on the end of its prior's range and would go on if it could."
    )
    models = ["before", "after"] if changes(found) else ["the model"]
    head = ["", *models, "prior's range", "at its bound"]
    return section(title, table(head, rows, range(1, len(models) + 2)), note(said))


def _plain(one: Json | None) -> str:
    return "–" if one is None else with_sd(one["mean"], one["sd"])


def _mark(one: Json | None, which: str) -> str:
    """Where a posterior leans, in words."""
    if one is None or not (one["at_low"] or one["at_high"]):
        return ""
    sides = [(one["at_low"], "lower"), (one["at_high"], "upper")]
    told = []
    for count, side in sides:
        if count:
            told.append(side if one["of"] == 1 else f"{side} for {count} of {one['of']} blades")
    return f"{which}: ".removeprefix(": ") + " and ".join(told)
