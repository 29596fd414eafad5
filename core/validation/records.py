"""Records of a study, one a line of a file, so that a study which was cut goes on where it was."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import as_completed
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeVar

import core
from core.pools import process_pool

Record = dict[str, Any]
Key = TypeVar("Key")


@cache
def code_digest() -> str:
    """SHA-256 of the core's source files and data, by name."""
    root = Path(core.__path__[0])
    total = sha256()
    for file in sorted([*root.rglob("*.py"), *root.rglob("*.npz")]):
        total.update(str(file.relative_to(root)).encode() + b"\0" + file.read_bytes() + b"\0")
    return total.hexdigest()


def records(
    calls: Mapping[Key, tuple[Any, ...]],
    work: Callable[..., Record],
    key: Callable[[Record], Key],
    *,
    file: Path | None = None,
    processes: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> list[Record]:
    """`work` of each call's arguments, in the order of `calls`.

    file  of finished records; what it holds of these calls is not computed again
    """
    done: dict[Key, Record] = {}
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        done = {key(one): one for one in lines(file) if key(one) in calls}
    todo = [given for k, given in calls.items() if k not in done]

    def keep(record: Record) -> None:
        done[key(record)] = record
        if file is not None:
            with open(file, "a") as out:
                out.write(json.dumps(record) + "\n")
        if progress is not None:
            progress(len(done), len(calls))

    if processes == 1:
        for given in todo:
            keep(work(*given))
    elif todo:
        with process_pool(processes) as made:
            for finished in as_completed([made.submit(work, *given) for given in todo]):
                keep(finished.result())
    return [done[k] for k in calls]


def lines(file: Path) -> Iterable[Record]:
    """The records of a file; a last line that was cut is left out, and the file mended."""
    if not file.exists():
        return []
    text = file.read_text()
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        file.write_text(whole)
    return [json.loads(line) for line in whole.splitlines()]
