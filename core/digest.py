"""What a persisted value is called by: SHA-256 over its description and the bytes of its arrays.

The digest of a state is made from the digests of its arrays, so that a store which knows those
names a new version without reading what did not change.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from hashlib import sha256
from io import BytesIO
from typing import Any

import numpy as np

Array = np.ndarray[Any, np.dtype[Any]]


def npy_bytes(array: Array) -> bytes:
    """An array as the bytes of a ``.npy`` file; no pickle."""
    array = np.ascontiguousarray(array) if array.ndim else array
    buffer = BytesIO()
    np.lib.format.write_array(buffer, array, allow_pickle=False)
    return buffer.getvalue()


def array_digest(array: Array) -> str:
    """SHA-256 of dtype, shape and values.

    >>> array_digest(np.zeros(2)) == array_digest(np.zeros((2, 1)))
    False
    """
    return sha256(npy_bytes(array)).hexdigest()


def state_digest(meta: Mapping[str, Any], arrays: Mapping[str, str]) -> str:
    """SHA-256 of a state: its description, and the digest of each array by name."""
    text = json.dumps([dict(meta), sorted(arrays.items())], sort_keys=True)
    return sha256(text.encode()).hexdigest()
