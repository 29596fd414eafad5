"""The runs that an archive lacks, shared out among workers.

Every worker goes through the runs in order and computes those that it can claim
(`core.archive.claims`). It ends when each run is there or has failed, so that it is still at hand
when another one dies. A run that failed is not tried again by workers that were at work when it
failed; the same command, given anew, tries it once more.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from core.archive.claims import EVERY_S, Claims
from core.archive.declaration import Run
from core.archive.layout import opened
from core.archive.store import Archive
from core.errors import ModelError

FOLDER = "claims"


class SharedRuns:
    """The runs `indices` of an archive for one worker.

    failures   (index, reason) of runs that failed elsewhere while this worker was there
    elsewhere  how many runs other workers have added meanwhile
    """

    def __init__(
        self, archive: Archive, indices: Sequence[int], *, every_s: float = EVERY_S
    ) -> None:
        self._archive = archive
        done = set(archive.done())
        for index in sorted(set(indices) - done):
            _set_aside(archive.file(index))
        self.claims = Claims(archive.path / FOLDER, every_s=every_s)
        self._open, self._mine = sorted(set(indices) - done), set[int]()
        self.elsewhere = 0
        self.failures: list[tuple[int, str]] = []

    def take(self) -> int | None:
        """A run that is now this worker's to compute; none: there is none at present."""
        newest = self.claims.newest() if self.waiting() else {}
        for index in [k for k in self._open if k not in self._mine]:
            if self._archive.file(index).exists():
                self._open.remove(index)
                self.elsewhere += 1
                continue
            found = newest.get(index)
            verdict = self.claims.take(index, found)
            if verdict == "taken" and self._archive.file(index).exists():
                self.claims.end(index, "done")  # it appeared between the two looks
            elif verdict == "taken":
                self._mine.add(index)
                return index
            elif verdict == "failed" and found is not None:
                self._open.remove(index)
                self.failures.append((index, str(found.told.get("reason", "not told"))))
        return None

    def waiting(self) -> bool:
        """Whether others hold runs, which may yet fall to this worker."""
        return len(self._open) > len(self._mine)

    def add(self, index: int, run: Run, **told: object) -> bool:
        """Publish a run that was taken; False: another was first. `told` is noted in the claim."""
        first = self._archive.add(index, run)
        self._close(index)
        self.claims.end(index, "done", first=first, **told)
        return first

    def failed(self, index: int, reason: str) -> None:
        """Tell that a run that was taken cannot be computed."""
        self._close(index)
        self.claims.end(index, "failed", reason=reason)

    def _close(self, index: int) -> None:
        self._open.remove(index)
        self._mine.discard(index)


def _set_aside(file: Path) -> None:
    """Move away a run's file that cannot be read, so that the run can be published again."""
    aside = file.with_name(f".{file.name}.damaged")
    try:
        with opened(file):
            return
    except ModelError:
        pass
    try:
        os.replace(file, aside)
    except FileNotFoundError:
        return
    try:  # between the look and the move another worker may have published it
        with opened(aside):
            os.link(aside, file)
    except (ModelError, FileExistsError):
        return
