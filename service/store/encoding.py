"""Arrays as bytes and back.

An array is kept as the bytes of a ``.npy`` file (format of numpy, no pickle in either direction)
beside its dtype, shape and the SHA-256 of the bytes. Reading checks all three, so that a damaged
row is named and never used.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from hashlib import sha256
from io import BytesIO
from typing import Any

import numpy as np

from core.digest import npy_bytes
from core.errors import ModelError

Array = np.ndarray[Any, np.dtype[Any]]
ENCODING = "npy"
HEAD_BYTES = 10  # magic, version, length of the rest of the head


class DamagedArrayError(ModelError):
    """A stored array whose bytes, dtype or shape are not what was written."""


@dataclass(frozen=True, slots=True)
class Encoded:
    """One array as it is stored."""

    encoding: str
    dtype: str
    shape: str
    sha256: str
    data: bytes


def shape_text(shape: tuple[int, ...]) -> str:
    """A shape as text.

    >>> shape_text((54, 3)), shape_text(())
    ('54x3', '')
    """
    return "x".join(map(str, shape))


def encode(array: Array) -> Encoded:
    """An array of numbers as bytes; objects are refused.

    >>> bool((decode("a", encode(np.array([1.5, 2.5]))) == [1.5, 2.5]).all())
    True
    """
    array = np.ascontiguousarray(array) if array.ndim else array
    if array.dtype.kind not in "biuf":
        raise ModelError(f"an array of dtype {array.dtype} is not stored; convert it to numbers")
    data = npy_bytes(array)
    digest = sha256(data).hexdigest()
    return Encoded(ENCODING, array.dtype.str, shape_text(array.shape), digest, data)


def decode(name: str, stored: Encoded) -> Array:
    """The array, read-only; DamagedArrayError where bytes, dtype or shape do not agree."""
    if stored.encoding != ENCODING:
        raise DamagedArrayError(f"array {name}: encoding {stored.encoding!r} is not {ENCODING!r}")
    found = sha256(stored.data).hexdigest()
    if found != stored.sha256:
        raise DamagedArrayError(
            f"array {name}: sha256 {found[:12]}… is not {stored.sha256[:12]}… as written. "
            "Restore the database, or delete the state and POST …/retry to recompute it."
        )
    try:
        array = _array(stored.data)
    except ValueError as error:
        raise DamagedArrayError(f"array {name}: {error}") from None
    if (array.dtype.str, shape_text(array.shape)) != (stored.dtype, stored.shape):
        raise DamagedArrayError(
            f"array {name}: {array.dtype.str} {array.shape} is not {stored.dtype} ({stored.shape})"
        )
    return array


def _array(data: bytes) -> Array:
    """What `numpy.load` makes of the bytes, as a view of them: read-only, without a copy."""
    size = HEAD_BYTES + int.from_bytes(data[8:HEAD_BYTES], "little")
    shape, fortran, dtype = _head(data[:size])
    array = np.frombuffer(data, dtype, offset=size)
    return array.reshape(shape, order="F" if fortran else "C")


@lru_cache(maxsize=1024)
def _head(head: bytes) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, whether by columns, and dtype. (To read it costs more than the array itself.)"""
    buffer = BytesIO(head)
    if np.lib.format.read_magic(buffer) != (1, 0):
        raise ValueError("it is not of version 1.0 of the npy format")
    shape, fortran, dtype = np.lib.format.read_array_header_1_0(buffer)
    if dtype.hasobject:
        raise ValueError("it holds objects")
    return shape, fortran, dtype
