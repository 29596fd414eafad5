"""A rotor in a few lines of Python: what the API's random test holds every answer against."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

Json = dict[str, Any]
FIRST = ("B1", "B2")


@dataclass
class Diagnosis:
    """A diagnosis that was asked for; `status` and `verdict` once it has ended."""

    id: str
    campaign: str
    through: int
    status: str = "queued"
    verdict: str | None = None


@dataclass
class Modelled:
    """A rotor as the model has it: its log, and its blades with the facts that they came with.

    posters     id of the key that each entry came with
    versions    as they were seen first, by number
    sealed      digest of the sealed posterior by the entry that it ends with
    moments     (a moment, the last entry before it), asked again later
    files       (an exported file, the last entry in it)
    notes       of the event stream, as they were told first
    reads       bytes of an answer, by what was asked for and the version
    tags        its ETag, by the address and then the version
    """

    particles: int
    created: bool = False
    entries: list[tuple[str, Json]] = field(default_factory=list)
    posters: dict[str, str] = field(default_factory=dict)
    blades: set[str] = field(default_factory=lambda: set(FIRST))
    versions: dict[int, Json] = field(default_factory=dict)
    sealed: dict[int, str] = field(default_factory=dict)
    moments: list[tuple[str, int]] = field(default_factory=list)
    diagnoses: list[Diagnosis] = field(default_factory=list)
    files: list[tuple[Path, int]] = field(default_factory=list)
    notes: list[Json] = field(default_factory=list)
    reads: dict[tuple[str, int], bytes] = field(default_factory=dict)
    tags: dict[str, dict[int, str]] = field(default_factory=dict)

    def seq(self, name: str) -> int:
        """Number of an entry, counted from 1; 0: it is not there."""
        return next((i for i, (known, _) in enumerate(self.entries, 1) if known == name), 0)

    def append(self, items: list[tuple[str, Json]], by: str) -> tuple[int, list[int], bool]:
        """(status, numbers, whether all are repetitions): all or nothing; `by` a key, by its id."""
        before, numbers = len(self.entries), []
        for name, content in items:
            seq = self.seq(name)
            if seq and self.entries[seq - 1][1] != content:
                del self.entries[before:]
                return 409, [], False
            if not seq:
                self.entries.append((name, content))
                seq = len(self.entries)
            numbers.append(seq)
        for name, _ in self.entries[before:]:
            self.posters[name] = by
        return 202, numbers, len(self.entries) == before

    def wrong(self, given: list[Json]) -> int:
        """Of readings to be posted, how many are refused."""
        faults = [r for r in given if r["blade"] not in self.blades or r.get("replaces") == r["id"]]
        named = {r["id"]: r["replaces"] for r in given if "replaces" in r}
        links = {n: c.get("replaces") for n, c in self.entries if "/" not in n} | named

        def around(own: str) -> bool:
            passed, above = set[str](), links.get(own)
            while above is not None and above != own and above not in passed:
                passed.add(above)
                above = links.get(above)
            return above == own

        return len(faults) or int(any(around(own) for own in named))

    def of_kind(self, kind: str, through: int | None = None) -> list[str]:
        """What the entries of a kind concern, up to one of them."""
        named = (name.partition("/") for name, _ in self.entries[:through])
        return [target for found, _, target in named if found == kind and target]

    def sheets(self, through: int | None = None) -> list[tuple[str, str]]:
        """(diagnosis, campaign) of each effect in the model, up to an entry, the first below."""
        found: list[tuple[str, str]] = []
        for name, content in self.entries[:through]:
            if name.startswith("adoption/"):
                found.append((content["diagnosis"], content["campaign"]))
            elif name.startswith("back-out/"):
                found.pop()
        return found

    def counting(self, through: int | None = None) -> dict[str, Json]:
        """The readings that count, up to an entry."""
        told = {n for _, n, status in self.listed(through) if status == "counts"}
        return {name: content for name, content in self.entries[:through] if name in told}

    def listed(self, through: int | None = None) -> list[tuple[int, str, str]]:
        """(number, id, status) of every reading, up to an entry."""
        entries = self.entries[:through]
        gone = {n.partition("/")[2] for n, _ in entries if n.startswith("retraction/")}
        own = [(i, n, c) for i, (n, c) in enumerate(entries, 1) if "/" not in n]
        names = {n: c.get("replaces") for _, n, c in own}
        over = set()
        for tip in names.keys() - gone:
            above, passed = names[tip], {tip}
            while above is not None and above not in passed:
                passed.add(above)
                above = names.get(above)
            over |= passed - {tip}
        return [
            (i, n, "retracted" if n in gone else "replaced" if n in over else "counts")
            for i, n, _ in own
        ]
