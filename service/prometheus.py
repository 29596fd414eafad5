"""Metrics in the text format of Prometheus (exposition format 0.0.4).

A family is a HELP line, a TYPE line and its samples; a histogram's buckets are cumulative and end
with ``+Inf``, which is its count. Label values escape backslash, quote and newline.
"""

from __future__ import annotations

import math
import threading
from bisect import bisect_left
from collections.abc import Iterable, Mapping, Sequence

MEDIA_TYPE = "text/plain; version=0.0.4; charset=utf-8"
Labels = tuple[str, ...]


def number(value: float) -> str:
    """A sample's value.

    >>> number(3), number(0.1), number(float("nan")), number(float("inf"))
    ('3', '0.1', 'NaN', '+Inf')
    """
    if math.isnan(value):
        return "NaN"
    if math.isinf(value):
        return "+Inf" if value > 0 else "-Inf"
    return repr(int(value)) if float(value).is_integer() else repr(float(value))


def sample(name: str, labels: Mapping[str, str], value: float) -> str:
    r"""One line.

    >>> print(sample("a_total", {"route": 'x"\\'}, 2))
    a_total{route="x\"\\"} 2
    """
    escaped = {
        key: text.replace("\\", r"\\").replace('"', r"\"").replace("\n", r"\n")
        for key, text in labels.items()
    }
    inside = ",".join(f'{key}="{text}"' for key, text in escaped.items())
    return f"{name}{{{inside}}} {number(value)}" if inside else f"{name} {number(value)}"


def family(
    name: str, kind: str, meaning: str, samples: Iterable[tuple[Mapping[str, str], float]]
) -> list[str]:
    """The lines of a counter or gauge."""
    head = [f"# HELP {name} {meaning}", f"# TYPE {name} {kind}"]
    return head + [sample(name, labels, value) for labels, value in samples]


class Histogram:
    """Counts of values by bucket and labels; safe between threads.

    bounds   upper bounds of the buckets, rising; a last one without bound is added
    """

    def __init__(
        self, name: str, meaning: str, labels: tuple[str, ...], bounds: tuple[float, ...]
    ) -> None:
        self.name, self.meaning, self.labels = name, meaning, labels
        self.bounds = (*bounds, math.inf)
        self._counts: dict[Labels, list[int]] = {}
        self._sums: dict[Labels, float] = {}
        self._lock = threading.Lock()

    def observe(self, labels: Labels, value: float) -> None:
        with self._lock:
            counts = self._counts.setdefault(labels, [0] * len(self.bounds))
            counts[bisect_left(self.bounds, value)] += 1
            self._sums[labels] = self._sums.get(labels, 0.0) + value

    def told(self) -> list[tuple[Labels, list[int], float]]:
        """What was observed, by labels: the count of each bucket, and the sum."""
        with self._lock:
            return [(key, list(counts), self._sums[key]) for key, counts in self._counts.items()]

    def add(self, told: Iterable[tuple[Sequence[str], Sequence[int], float]]) -> None:
        """What another histogram of the same buckets told."""
        with self._lock:
            for labels, more, total in told:
                key = tuple(labels)
                counts = self._counts.get(key, [0] * len(self.bounds))
                self._counts[key] = [a + b for a, b in zip(counts, more, strict=True)]
                self._sums[key] = self._sums.get(key, 0.0) + total

    def lines(self) -> list[str]:
        found = {key: (counts, total) for key, counts, total in self.told()}
        lines = [f"# HELP {self.name} {self.meaning}", f"# TYPE {self.name} histogram"]
        for key, (counts, total) in sorted(found.items()):
            labels = dict(zip(self.labels, key, strict=True))
            reached = 0
            for bound, count in zip(self.bounds, counts, strict=True):
                reached += count
                lines.append(sample(f"{self.name}_bucket", labels | {"le": number(bound)}, reached))
            lines.append(sample(f"{self.name}_sum", labels, total))
            lines.append(sample(f"{self.name}_count", labels, reached))
        return lines


class Counter:
    """A count by labels; safe between threads."""

    def __init__(self, name: str, meaning: str, labels: tuple[str, ...]) -> None:
        self.name, self.meaning, self.labels = name, meaning, labels
        self._counts: dict[Labels, int] = {}
        self._lock = threading.Lock()

    def count(self, labels: Labels) -> None:
        self.add([(labels, 1)])

    def told(self) -> list[tuple[Labels, int]]:
        """What was counted, by labels."""
        with self._lock:
            return sorted(self._counts.items())

    def add(self, told: Iterable[tuple[Sequence[str], int]]) -> None:
        """What another counter told."""
        with self._lock:
            for labels, more in told:
                key = tuple(labels)
                self._counts[key] = self._counts.get(key, 0) + more

    def lines(self) -> list[str]:
        samples = [(dict(zip(self.labels, key, strict=True)), count) for key, count in self.told()]
        return family(self.name, "counter", self.meaning, samples)
