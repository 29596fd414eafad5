"""What is dear to make is made by one process of a test session; the others read it."""

from __future__ import annotations

import fcntl
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import pytest

T = TypeVar("T")


def once(paths: pytest.TempPathFactory, name: str, make: Callable[[Path], T]) -> T:
    """A copy of what `make(folder)` returned to the first process that asked; the folder stays.

    The processes of pytest-xdist have their own folders beside each other in one of the session.
    """
    own = paths.getbasetemp()
    common = own.parent if own.name.startswith("popen-") else own
    kept = common / f"{name}.pickle"
    with open(common / f"{name}.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not kept.exists():
            kept.write_bytes(pickle.dumps(make(common / name)))
    found: T = pickle.loads(kept.read_bytes())
    return found
