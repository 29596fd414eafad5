"""Memory of a process that allocates in bursts, given back.

glibc keeps arenas of memory for threads that allocate at once, up to eight for each processor. What
a request takes (pages of SQLite, bodies) goes back to the arena of the thread that took it, and
waits there for that thread: with forty threads a process holds many times what it uses at a moment,
and more with every burst. Threads of Python allocate one at a time, so two arenas serve them all.

An arena only shrinks from its end, and what stays from a burst lies anywhere in it. So the free
pages of all arenas are given back now and then (``malloc_trim``: some milliseconds for 80 MB, in a
thread that does not hold the interpreter's lock).
"""

from __future__ import annotations

import ctypes
import platform
import threading

M_ARENA_MAX = -8  # of malloc.h
MOST = 2
TRIM_S = 60.0


def share_arenas() -> bool:
    """Have all threads that begin from now on share `MOST` arenas; False: not glibc."""
    if platform.libc_ver()[0] != "glibc":
        return False
    return bool(ctypes.CDLL(None).mallopt(M_ARENA_MAX, MOST))


def give_back(every_s: float = TRIM_S) -> bool:
    """Give free pages back to the system from now on, as long as the process lives; False: not
    glibc."""
    if platform.libc_ver()[0] != "glibc":
        return False
    trim, never = ctypes.CDLL(None).malloc_trim, threading.Event()

    def work() -> None:
        while not never.wait(every_s):
            trim(0)

    threading.Thread(target=work, name="give-back", daemon=True).start()
    return True
