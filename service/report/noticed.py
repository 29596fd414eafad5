"""What would have been noticed, where nothing was found (`core.diagnosis.noticed`)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from service.report.markup import Markup
from service.report.tables import note, section, table
from service.report.words import number, unit_of

Json = Mapping[str, Any]
WHOM = {
    "all": "all blades",
    "lot": "a lot",
    "coating_lot": "a coating lot",
    "instrument": "an instrument",
    "campaign": "a campaign",
}
TITLE = "What would have been noticed"


def noticed(found: Json) -> Markup | None:
    """A row for each family of effects; None where something was found, or of older reports."""
    told = found.get("noticed")
    if not told or not told["families"]:
        return None
    model = found["rests_on"]["model"]
    rows = [[_what(one), *_sizes(one, model), one["of"]] for one in told["families"]]
    head = ["effect", "noticed from", "at worst from", "of what"]
    said = (
        f"Sizes that would have raised the alarm with {told['probability']:.0%} probability, each "
        "by itself, where the readings tell most of it and where least; –: it would have to be "
        "larger than is looked for. Effects of single blades are not told."
    )
    return section(TITLE, table(head, rows, (1, 2)), note(said))


def blind(found: Json) -> bool:
    """Whether nothing of the sizes that are expected would have been noticed."""
    families = (found.get("noticed") or {}).get("families", ())
    return bool(families) and all(one["least"] is None for one in families)


def lines(found: Json) -> Iterator[str]:
    """The same as lines of a terminal; where it is nothing, the verdict's reasons say so."""
    told = found.get("noticed")
    if not told or not told["families"] or blind(found):
        return
    yield f"an alarm would have been raised, with {told['probability']:.0%} probability, by"
    model = found["rests_on"]["model"]
    for one in told["families"]:
        least, most = _sizes(one, model)
        sizes = least if most == least else f"{least} … {most}"
        yield f"  {_what(one):<42} {sizes}"


def _what(one: Json) -> str:
    return f"{one['family']}, {WHOM.get(one['whom'], one['whom'])}"


def _sizes(one: Json, model: str) -> tuple[str, str]:
    """The least size where it is easiest to notice, and where it is hardest."""
    scale, unit = unit_of(one, one["unit"], model)

    least, most = (
        "–" if one[end] is None else f"{number(scale * one[end], 2)} {unit}".rstrip()
        for end in ("least", "most")
    )
    if least == most:
        return least, most
    return _at(least, one["easiest"]), _at(most, one["hardest"])


def _at(size: str, which: str) -> str:
    return f"{size} ({which})" if which and size != "–" else size
