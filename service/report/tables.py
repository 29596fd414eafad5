"""Tables, lists of facts and figures as HTML."""

from __future__ import annotations

from collections.abc import Sequence

from service.report.markup import Child, Markup, el, join


def table(
    head: Sequence[str], rows: Sequence[Sequence[Child]], numeric: Sequence[int] = ()
) -> Markup:
    """A table; columns of `numeric` stand right. A cell of markup ``<td …>`` stays as it is."""
    top = el(
        "tr",
        *(
            el("th", h, class_="n" if i in numeric else None, scope="col")
            for i, h in enumerate(head)
        ),
    )
    body = [
        el("tr", *(cell(one, numeric=i in numeric) for i, one in enumerate(row))) for row in rows
    ]
    made = el("table", el("thead", top), el("tbody", *body))
    return across(made, "Table: " + ", ".join(one for one in head if one))


def across(made: Markup, name: str) -> Markup:
    """What is wider than a small screen is scrolled where it stands, by keyboard too."""
    return el("div", made, class_="wide", tabindex="0", role="region", aria_label=name)


def cell(child: Child, *, numeric: bool = False, kind: str = "") -> Markup:
    """One cell, of a kind (better, worse, mark)."""
    if isinstance(child, Markup) and child.startswith("<td"):
        return child
    classes = " ".join(c for c in ("n" if numeric else "", kind) if c)
    return el("td", child, class_=classes or None)


def figure(drawn: Markup, caption: str) -> Markup:
    return el("figure", across(drawn, f"Picture: {caption}"), el("figcaption", caption))


def facts(told: Sequence[tuple[str, str]]) -> Markup:
    """Key figures: (value, what it is)."""
    return el("ul", *(el("li", el("b", v), el("span", what)) for v, what in told), class_="facts")


def pairs(told: Sequence[tuple[str, Child]]) -> Markup:
    """A list of names and values."""
    return el("dl", *(join((el("dt", name), el("dd", value))) for name, value in told))


def section(title: str, *children: Child) -> Markup:
    return el("section", el("h2", title), *children)


def note(said: str) -> Markup:
    return el("p", said, class_="note")
