"""HTML and SVG written by hand: every text is escaped unless it is markup already.

`Markup` is text that is markup; `el` makes an element of it. Names of blades and campaigns come
from users: a plain string can stand anywhere, and never becomes a tag or ends an attribute.
"""

from __future__ import annotations

from html import escape


class Markup(str):
    """Text that is markup already."""

    __slots__ = ()


Child = str | Markup


def text(child: Child) -> Markup:
    """A child as markup.

    >>> text("<b>"), text(Markup("<b>"))
    ('&lt;b&gt;', '<b>')
    """
    return child if isinstance(child, Markup) else Markup(escape(clean(child)))


def clean(value: str) -> str:
    """Without characters that no document may hold (controls, surrogates).

    >>> clean("a\\x00b\\tc")
    'ab\\tc'
    """
    return "".join(
        c
        for c in value
        if c in "\t\n" or (c >= " " and not "\x7f" <= c < "\xa0" and not "\ud800" <= c <= "\udfff")
    )


def el(name: str, *children: Child, **attributes: str | float | None) -> Markup:
    """An element; `class_` is class, `_` in other names is `-`, None leaves an attribute out.

    >>> el("p", "a < b", class_='x"y')
    '<p class="x&quot;y">a &lt; b</p>'
    >>> el("line", x1=1.23456, stroke_width=2)
    '<line x1="1.23" stroke-width="2"></line>'
    """
    told = ""
    for key, value in attributes.items():
        if value is None:
            continue
        shown = f"{value:.2f}".rstrip("0").rstrip(".") if isinstance(value, float) else str(value)
        told += f' {key.rstrip("_").replace("_", "-")}="{escape(clean(shown))}"'
    return Markup(f"<{name}{told}>{join(children)}</{name}>")


def join(children: tuple[Child, ...] | list[Child] | list[Markup]) -> Markup:
    """Children one after another, as markup."""
    return Markup("".join(text(child) for child in children))
