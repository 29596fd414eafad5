"""Machine code that this process compiled itself is not computed with where bits count.

A sealed posterior is a function of its readings, bit for bit. The kernels are compiled once and
their code is kept (`core.compiled`). A process that loads the kept code gets the same bits as every
other that does; the process that compiled it does not: its results differ in the last digit (seen:
1e-15, by the study of chaos with the blade physics, whose first workers compiled). So a worker or
command that finds that it compiled something drops what it computed, and runs again from its
beginning (`again`) with the code that it has kept by then.

Where code cannot be kept (a full or read-only cache) that would never end. A process that compiles
the same function for the fourth time computes with it all the same and says so in the log.
"""

from __future__ import annotations

import logging
import os
import sys
from hashlib import sha256
from types import ModuleType
from typing import Any, NoReturn

from core.errors import BladetwinError

log = logging.getLogger("bladetwin.kernels")
NOTED = "_BLADETWIN_COMPILED"  # not a setting: from a process to itself, run again
MOST = 3


class CompiledError(BladetwinError):
    """What was computed is dropped: this process compiled kernels that others load."""

    def __init__(self, names: list[str]) -> None:
        self.names = names
        super().__init__(
            f"{len(names)} kernel(s) were compiled here, {names[0]} first, and what they computed "
            "is dropped. Run it again: the machine code is loaded from now on."
        )


def compiled_here(modules: dict[str, ModuleType] | None = None) -> list[str]:
    """Names of the kernels that this process compiled, one for each signature, in order."""
    if "numba" not in sys.modules:
        return []
    from numba.core.dispatcher import Dispatcher

    found: dict[str, None] = {}
    for name, module in sorted((modules or dict(sys.modules)).items()):
        if not name.startswith("core."):
            continue
        for one in list(vars(module).values()):
            if isinstance(one, Dispatcher):
                found |= dict.fromkeys(_missed(one))
    return list(found)


def _missed(dispatcher: Any) -> list[str]:
    function = dispatcher.py_func
    name = f"{function.__module__}.{function.__qualname__}"
    return [f"{name} {signature}" for signature in dispatcher.stats.cache_misses]


def insist() -> None:
    """CompiledError where this process compiled anything, unless that is of no use again."""
    names = compiled_here()
    if not names:
        return
    before = _noted()
    if all(before.get(_short(name), 0) < MOST for name in names):
        raise CompiledError(names)
    if _Told.once:
        _Told.once = False
        log.error(
            "kernels are compiled at each start, %s first, since their machine code is not kept: "
            "sealed states may differ in the last digit from other workers'. To mend it: let the "
            "user %d write beside the package, or set NUMBA_CACHE_DIR.",
            names[0],
            os.geteuid(),
        )


class _Told:
    """Whether the error is still to be told."""

    once = True


def again(error: CompiledError) -> NoReturn:
    """Run this very command again in this process: same pid, same standard input."""
    before = _noted()
    for name in error.names:
        before[_short(name)] = before.get(_short(name), 0) + 1
    os.environ[NOTED] = " ".join(f"{name}:{count}" for name, count in before.items())
    log.warning("%s", error)
    sys.stdout.flush()
    sys.stderr.flush()
    os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])


def _noted() -> dict[str, int]:
    pairs = (one.partition(":") for one in os.environ.get(NOTED, "").split())
    return {name: int(count) for name, _, count in pairs if count.isdigit()}


def _short(name: str) -> str:
    return sha256(name.encode()).hexdigest()[:12]
