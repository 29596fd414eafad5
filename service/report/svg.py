"""Axes and marks as inline SVG: units on the axes, colours by class, so that light, dark and print
are the style sheet's business.

A picture is `WIDE` units wide and scales with the page. Scales map values to units; texts are
twelve units high.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from service.report.markup import Child, Markup, el, join
from service.report.words import LARGE

WIDE = 720.0
EM = 12.0
LETTER = 0.58 * EM  # a letter's mean width


@dataclass(frozen=True, slots=True)
class Scale:
    """Values low … high on units start … end; `log`: by their logarithm."""

    low: float
    high: float
    start: float
    end: float
    log: bool = False

    def __call__(self, value: float) -> float:
        """Where a value is.

        >>> Scale(0.0, 10.0, 100.0, 200.0)(2.5), Scale(0.01, 1.0, 0.0, 100.0, log=True)(0.1)
        (125.0, 50.0)
        """
        low, high, at = self.low, self.high, value
        if self.log:
            low, high, at = math.log(low), math.log(high), math.log(max(at, 1e-300))
        return self.start + (at - low) / (high - low) * (self.end - self.start)

    def ticks(self, about: int = 5) -> list[tuple[float, str]]:
        """Round values and their labels.

        >>> Scale(0.0, 1.0, 0.0, 1.0).ticks()
        [(0.0, '0'), (0.2, '0.2'), (0.4, '0.4'), (0.6, '0.6'), (0.8, '0.8'), (1.0, '1')]
        >>> [label for _, label in Scale(0.001, 1.0, 0.0, 1.0, log=True).ticks()]
        ['0.001', '0.01', '0.1', '1']
        """
        if self.log:
            ends = math.ceil(math.log10(self.low) - 1e-9), math.floor(math.log10(self.high) + 1e-9)
            return [(10.0**k, f"{10.0**k:g}") for k in range(ends[0], ends[1] + 1)]
        step = nice((self.high - self.low) / max(about, 1))
        first, last = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
        return [(float(f"{k * step:.12g}"), plain(k * step, step)) for k in range(first, last + 1)]


def nice(rough: float) -> float:
    """The round number next to a step: 1, 2, 2.5 or 5 times a power of ten.

    >>> nice(0.23), nice(7.0)
    (0.25, 5.0)
    """
    power = 10.0 ** math.floor(math.log10(rough))
    return float(min((1.0, 2.0, 2.5, 5.0, 10.0), key=lambda m: abs(m * power - rough)) * power)


def plain(value: float, step: float) -> str:
    """A tick's label with the digits of its step, a true minus, and no −0.

    >>> plain(-0.25, 0.05), plain(20000.0, 10000.0), plain(-1e-17, 0.1), plain(2.5e26, 5e25)
    ('−0.25', '20,000', '0', '2.5e26')
    """
    if step >= LARGE / 10:
        return f"{value:.3g}".replace("e+", "e").replace("-", "−")
    digits = max(0, -math.floor(math.log10(step) + 1e-9) + (1 if f"{step:e}"[2] == "5" else 0))
    shown = f"{value:,.{min(digits, 8)}f}"
    shown = shown.rstrip("0").rstrip(".") if "." in shown else shown
    return "0" if shown in ("-0", "0") else shown.replace("-", "−")


def padded(values: Sequence[float], share: float = 0.06) -> tuple[float, float]:
    """Bounds a little beyond all values, never equal."""
    low, high = min(values), max(values)
    if high <= low:
        low, high = low - max(abs(low), 1e-9) * 0.1, high + max(abs(high), 1e-9) * 0.1
    room = share * (high - low)
    return low - room, high + room


@dataclass(frozen=True, slots=True)
class Frame:
    """Axes: a horizontal and a vertical scale with their titles."""

    x: Scale
    y: Scale
    x_title: str
    y_title: str = ""
    grid_x: bool = True
    grid_y: bool = True

    @property
    def box(self) -> tuple[float, float, float, float]:
        """Left, top, width, height."""
        top = min(self.y.start, self.y.end)
        return self.x.start, top, self.x.end - self.x.start, abs(self.y.end - self.y.start)

    def drawn(self, *, x_ticks: bool = True, y_ticks: bool = True) -> Markup:
        """Grid, ticks and titles."""
        left, top, width, height = self.box
        parts = [el("rect", x=left, y=top, width=width, height=height, class_="frame")]
        for value, label in self.x.ticks(max(2, int(width // 105))) if x_ticks else []:
            at = self.x(value)
            if self.grid_x:
                parts.append(line(at, top, at, top + height, "grid"))
            inside = min(at, WIDE - 0.5 * len(label) * LETTER)
            parts.append(words(inside, top + height + 15, label, "tick", "middle"))
        for value, label in self.y.ticks(max(2, int(height // 34))) if y_ticks else []:
            at = self.y(value)
            if self.grid_y:
                parts.append(line(left, at, left + width, at, "grid"))
            parts.append(words(left - 6, at + 4, label, "tick", "end"))
        parts.append(words(left + width / 2, top + height + 33, self.x_title, "title", "middle"))
        if self.y_title:
            x, y = left - 52, top + height / 2
            turn = f"rotate(-90 {x:.1f} {y:.1f})"
            parts.append(words(x, y, self.y_title, "title", "middle", transform=turn))
        return join(parts)


def picture(height: float, *children: Child, label: str) -> Markup:
    """A picture with what it shows, for who cannot see it."""
    return el(
        "svg", *children, viewBox=f"0 0 {WIDE:g} {height:g}", role="img", aria_label=label,
        xmlns="http://www.w3.org/2000/svg",
    )  # fmt: skip


def line(x1: float, y1: float, x2: float, y2: float, kind: str) -> Markup:
    return el("line", x1=x1, y1=y1, x2=x2, y2=y2, class_=kind)


def dot(x: float, y: float, kind: str, r: float = 2.5, title: str | None = None) -> Markup:
    inner = () if title is None else (el("title", title),)
    return el("circle", *inner, cx=x, cy=y, r=r, class_=kind)


def block(
    x: float, y: float, width: float, height: float, kind: str, title: str | None = None
) -> Markup:
    inner = () if title is None else (el("title", title),)
    return el("rect", *inner, x=x, y=y, width=max(width, 0.5), height=height, class_=kind)


def words(
    x: float, y: float, said: str, kind: str, anchor: str = "start", transform: str | None = None
) -> Markup:
    return el("text", said, x=x, y=y, class_=kind, text_anchor=anchor, transform=transform)


def path(points: Sequence[tuple[float, float]], kind: str, *, closed: bool = False) -> Markup:
    told = "M" + "L".join(f"{x:.1f},{y:.1f}" for x, y in points) + ("Z" if closed else "")
    return el("path", d=told, class_=kind)


def band(x: Sequence[float], low: Sequence[float], high: Sequence[float], kind: str) -> Markup:
    """The area between two courses, in units."""
    there = list(zip(x, high, strict=True))
    back = list(zip(x, low, strict=True))[::-1]
    return path([*there, *back], kind, closed=True)


def legend(x: float, y: float, entries: Sequence[tuple[str, str]]) -> Markup:
    """Entries (class of the mark, words) in a row; a mark is a small block, none where no class."""
    parts: list[Markup] = []
    at = x
    for kind, said in entries:
        if kind:
            parts.append(block(at, y - 9, 14, 10, kind))
            at += 19
        parts.append(words(at, y, said, "tick"))
        at += len(said) * LETTER + 20
    return join(parts)


def short(said: str, most: int) -> str:
    """Not longer than so many letters.

    >>> short("campaign offset", 9)
    'campaign…'
    """
    return said if len(said) <= most else said[: most - 1].rstrip() + "…"
