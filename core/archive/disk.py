"""Files that are whole or not there, on a local disk and on NFS.

A file is written under a name of one's own, flushed to the disk, and renamed (the last one wins) or
linked (the first one stays). A killed write leaves its part under a name that nobody reads.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from uuid import uuid4

from core.errors import ModelError


def replace_file(path: Path, fill: Callable[[Path], object]) -> None:
    """Write under a temporary name, flush to the disk, rename."""
    part = part_of(path)
    try:
        fill(part)
        flush(part)
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def first_file(path: Path, fill: Callable[[Path], object]) -> bool:
    """Write under a temporary name, flush to the disk, link; False where another was first.

    A disk without hard links holds archives of one worker: there the file is renamed.
    """
    part = part_of(path)
    try:
        fill(part)
        flush(part)
        try:
            return link_file(part, path)
        except ModelError:
            os.replace(part, path)
            return True
    finally:
        part.unlink(missing_ok=True)


def link_file(part: Path, path: Path) -> bool:
    """Give a file a second name that must not exist; False if it does.

    On NFS a call may succeed and its answer be lost; repeated, it says that the name exists. Then
    the number of links tells whose it is.
    """
    try:
        os.link(part, path)
    except FileExistsError:
        return os.stat(part).st_nlink == 2
    except FileNotFoundError:
        raise
    except OSError as error:
        raise ModelError(
            f"{path.parent} has no hard links ({error.strerror}): several workers cannot share "
            "it. Put the archive on a local disk or on NFS"
        ) from error
    return True


def part_of(path: Path) -> Path:
    """A name of one's own, on whichever machine."""
    return path.with_name(f".{path.name}.{uuid4().hex}.part")


def flush(path: Path) -> None:
    with open(path, "rb") as handle:
        os.fsync(handle.fileno())
