"""One random stream for each thing that is updated.

Randomness belongs to what is updated, never to the moment or the order in which it happens:
the stream of ``(seed, *key)`` is the same on every machine, in every process and for every
order of arrival. Equal keys give equal streams; any other key gives an independent one (a
128-bit BLAKE2b digest seeds PCG64 through numpy's ``SeedSequence``).
"""

from __future__ import annotations

from hashlib import blake2b

import numpy as np


def seed_of(seed: int, *key: str | int) -> int:
    """A 128-bit integer that depends on every part of the key and on their borders.

    >>> seed_of(7, "rotor-1", "ab") == seed_of(7, "rotor-1a", "b")
    False
    """
    text = "\x1f".join([str(int(seed)), *map(str, key)])
    return int.from_bytes(blake2b(text.encode(), digest_size=16).digest(), "big")


def stream(seed: int, *key: str | int) -> np.random.Generator:
    """The generator of ``(seed, *key)``.

    >>> float(stream(7, "rotor-1", "move").random()) == float(stream(7, "rotor-1", "move").random())
    True
    """
    return np.random.default_rng(seed_of(seed, *key))
