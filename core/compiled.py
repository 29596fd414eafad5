"""The ways in which this project compiles a function with numba.

``compiled`` keeps every rule of IEEE arithmetic; ``fused`` lets a product and a sum become one
operation; ``contracted`` also allows what makes sums over rows vectorise (regrouping), but no
assumption on NaN or infinity. All release the
interpreter's lock, so that threads share a column, and divide as numpy does: 1 / 0 is inf, and
callers refuse results that are not finite.

The machine code is kept beside the module. Numba renews it when the function's own file changes,
by time and size: a change in a *callee's* file goes unseen, and so does an upgrade by wheel, whose
files carry one fixed time. Here the stamp is a digest of the whole room's sources.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from typing import Any

from numba import njit

Function = Callable[..., Any]


@lru_cache(maxsize=16)
def stamp_of(folder: Path) -> tuple[str, int]:
    """Digest of the sources in a folder, in the form of numba's own stamp (a pair)."""
    digest, size = sha256(), 0
    for file in sorted(folder.glob("*.py")):
        text = file.read_bytes()
        digest.update(file.name.encode() + b"\0" + text)
        size += len(text)
    return digest.hexdigest(), size


def _made(function: Function, **options: Any) -> Any:
    result: Any = njit(cache=True, nogil=True, error_model="numpy", **options)(function)
    folder = Path(function.__code__.co_filename).parent
    result._cache._cache_file._source_stamp = stamp_of(folder)
    return result


def compiled(function: Function) -> Any:
    """Compile on the first call, with strict arithmetic."""
    return _made(function)


def fused(function: Function) -> Any:
    """Compile on the first call; products may be fused with sums, nothing else."""
    return _made(function, fastmath={"contract"})


def contracted(function: Function) -> Any:
    """Compile on the first call; sums may be regrouped and products fused."""
    return _made(function, fastmath={"contract", "reassoc", "nsz", "arcp"})
