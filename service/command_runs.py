"""Runs of a command of the user's, for an adaptive design (`service.refining`).

The command is called once a run, with two file names behind its own words,

    COMMAND in.json out.json        {"inputs": {"roughness": 2.4, …}, "time_h": [0, 250, …]}

and writes ``{"drop": [0.0, 1.31, …]}`` to the second: each quantity of the network over the
instants (T,), a field (T, N) or vectors (T, N, 3); or the same arrays to ``out.npz`` beside it.
Exit status other than 0, no file, or numbers that do not fit are a run that failed, with what was
said.
"""

from __future__ import annotations

import json
import shlex
import subprocess
import tempfile
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from core.archive import Archive, Run
from core.errors import BladetwinError, InputError, ModelError
from core.network import Network
from service import sampling
from service.refining import Array, Done, fits, present

UNREADABLE = (
    OSError, ValueError, TypeError, AttributeError, EOFError, OverflowError,
    zipfile.BadZipFile, zlib.error,
)  # fmt: skip


@dataclass(frozen=True)
class Command:
    """Runs of a command of the user's, `workers` at once."""

    words: tuple[str, ...]
    network: Network
    time_h: tuple[float, ...] = ()
    nodes: int = 0
    workers: int = 1
    timeout: float = 3600.0

    @staticmethod
    def of(text: str, network: Network, **more: Any) -> Command:
        """From a command line; InputError where it has no words."""
        try:
            words = tuple(shlex.split(text))
        except ValueError as error:
            raise InputError("command", text, f"cannot be read: {error}", "mend quotes") from None
        if not words:
            raise InputError("command", text, "has no words", "give a program")
        return Command(words, network, **more)

    def open(self, folder: Path, seed: int) -> Archive:
        archive = present(folder)
        if archive is None:
            told = f"bladetwin model refine, {self.words[0]}"
            return sampling.archive_of(self.network, folder, self.time_h, self.nodes, seed, told)
        fits(archive, self.network, self.time_h)
        return archive

    def run(self, archive: Archive, points: Mapping[int, Array], done: Done) -> dict[int, str]:
        failed: dict[int, str] = {}
        with ThreadPoolExecutor(self.workers) as pool:
            waiting = {pool.submit(self._one, archive, k, x): k for k, x in points.items()}
            for count, one in enumerate(as_completed(waiting), 1):
                try:
                    one.result()
                except BladetwinError as error:
                    failed[waiting[one]] = str(error)
                done(count)
        return failed

    def _one(self, archive: Archive, index: int, x: Array) -> None:
        declared = archive.declaration
        inputs = dict(zip((i.name for i in declared.inputs), map(float, x), strict=True))
        with tempfile.TemporaryDirectory(prefix="bladetwin-run-") as folder:
            asked, answer = Path(folder) / "in.json", Path(folder) / "out.json"
            asked.write_text(json.dumps({"inputs": inputs, "time_h": declared.time_h}))
            self._call([*self.words, str(asked), str(answer)])
            found = _answer(answer)
        values = {}
        for q in declared.quantities:
            name = sampling.told_name(q.name, self.network)
            if name not in found:
                raise ModelError(f"the command wrote no {name}: it wrote {sorted(found)}")
            values[q.name] = found[name]
        archive.write(index, Run(inputs, values))

    def _call(self, words: Sequence[str]) -> None:
        try:
            done = subprocess.run(
                words, capture_output=True, timeout=self.timeout, check=False, text=True,
                errors="replace", stdin=subprocess.DEVNULL,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            raise ModelError(f"{self.words[0]} took longer than {self.timeout:g} s") from None
        except OSError as error:
            raise ModelError(f"{self.words[0]} cannot be started: {error.strerror}") from None
        if done.returncode:
            said = (done.stderr.strip() or done.stdout.strip() or "nothing").splitlines()[-1]
            raise ModelError(f"{self.words[0]} ended with {done.returncode}: {said[:300]}")


def _answer(file: Path) -> dict[str, Array]:
    """The arrays by name that a command wrote."""
    packed = file.with_suffix(".npz")
    try:
        if packed.exists():
            with open(packed, "rb") as written, np.load(written, allow_pickle=False) as data:
                return {name: np.asarray(data[name], dtype=float) for name in data.files}
        told = json.loads(file.read_text())
        return {name: np.asarray(value, dtype=float) for name, value in told.items()}
    except FileNotFoundError:
        raise ModelError("the command wrote neither out.json nor out.npz") from None
    except UNREADABLE as error:
        raise ModelError(f"what the command wrote cannot be read: {error}") from None
