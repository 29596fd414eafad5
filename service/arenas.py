"""Memory of a process with many threads, given back.

glibc keeps arenas of memory for threads that allocate at once, up to eight for each processor. What
a request takes (pages of SQLite, bodies) goes back to the arena of the thread that took it, and
waits there for that thread: with forty threads a process holds many times what it uses at a moment,
and more with every burst. Threads of Python allocate one at a time, so two arenas serve them all.
"""

from __future__ import annotations

import ctypes
import platform

M_ARENA_MAX = -8  # of malloc.h
MOST = 2


def share_arenas() -> bool:
    """Have all threads that begin from now on share `MOST` arenas; False: not glibc."""
    if platform.libc_ver()[0] != "glibc":
        return False
    return bool(ctypes.CDLL(None).mallopt(M_ARENA_MAX, MOST))
