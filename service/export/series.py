"""Fields over hours: a PVD collection of VTU files, or numpy arrays, each as one zip.

A PVD names for each hour (`timestep`) and each part the VTU file beside it::

    field.pvd
    0001-B01/000.vtu    part 0 at the first hour
    0001-B01/001.vtu    … at the second

ParaView and PyVista open the PVD once the zip is unpacked, and play the hours. The numpy file is
what ``numpy.load`` reads: `time_h` (T,), `mean` and `sd` (T, N) or (T, N, 3), `unit`, and `facts`
as a text of JSON.

The blades of a rotor stand around its axis, x: a point (x, y, z) of a blade at the angle a goes to
(x, y cos a − z sin a, y sin a + z cos a), and the mean of a vector is turned with it, so that
ParaView warps the right way. A vector's sd keeps the blade's own axes, for a turned one would need
the covariance of y and z.

A zip is written as it is sent, file by file, and is a function of its content: no clock is in it.
"""

from __future__ import annotations

import io
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any
from xml.sax.saxutils import quoteattr
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

import numpy as np
from numpy.typing import NDArray

from service.ports import BladeRecord

Array = NDArray[np.float64]
SAFE = re.compile(r"[^A-Za-z0-9._+-]")
MOST_SLOTS = 400
STILL = (1980, 1, 1, 0, 0, 0)


class _Sink(io.RawIOBase):
    """Takes what a zip writes until it is fetched."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []

    def writable(self) -> bool:
        return True

    def write(self, data: Any) -> int:
        self._parts.append(bytes(data))
        return len(self._parts[-1])

    def taken(self) -> bytes:
        whole, self._parts = b"".join(self._parts), []
        return whole


def zipped(files: Iterable[tuple[str, bytes]]) -> Iterator[bytes]:
    """A zip of files, in pieces as they come.

    >>> whole = b"".join(zipped([("a/b.txt", b"told")]))
    >>> ZipFile(io.BytesIO(whole)).read("a/b.txt")
    b'told'
    """
    sink = _Sink()
    with ZipFile(sink, "w", ZIP_DEFLATED, compresslevel=1) as archive:
        for name, body in files:
            archive.writestr(ZipInfo(name, STILL), body, ZIP_DEFLATED, 1)
            yield sink.taken()
    yield sink.taken()


def vtu_name(part: int, blade: str, step: int) -> str:
    """Where a VTU lies beside its PVD; whatever a blade is called, no two are the same.

    >>> vtu_name(0, "B:1", 7)
    '0001-B_1/007.vtu'
    """
    return f"{part + 1:04d}-{SAFE.sub('_', blade)}/{step:03d}.vtu"


def pvd(blades: Sequence[str], hours: Sequence[float]) -> bytes:
    """The collection: for each hour a file of each blade, as `vtu_name` has them."""
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        '<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">',
        "<Collection>",
        *(
            f'<DataSet timestep="{hour!r}" part="{part}" name={quoteattr(blade)} '
            f'file="{vtu_name(part, blade, step)}"/>'
            for step, hour in enumerate(hours)
            for part, blade in enumerate(blades)
        ),
        "</Collection>",
        "</VTKFile>",
    ]
    return ("\n".join(lines) + "\n").encode()


def npz(arrays: Mapping[str, Array], unit: str, facts: Mapping[str, Any]) -> Iterator[bytes]:
    """Arrays, their unit and what they rest on, as ``numpy.load`` reads them without pickle."""
    told = {**arrays, "unit": np.array(unit), "facts": np.array(json.dumps(facts))}
    return zipped((f"{name}.npy", _npy(values)) for name, values in told.items())


def _npy(values: NDArray[Any]) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, values, allow_pickle=False)
    return buffer.getvalue()


def angles(
    blades: Sequence[BladeRecord], everyone: Sequence[BladeRecord] | None = None
) -> list[float]:
    """Where blades stand around the rotor's axis [rad]: by slot from 0 on.

    everyone   the blades of the rotor, those that left included; None: these are all
    By the slots' numbers, which count from 1 or from 0, where all blades that run have one of
    their own, else in their order: a blade stands where it stands, whichever of them are shown.

    >>> [round(a / np.pi, 3) for a in angles([BladeRecord("A", slot="4"), BladeRecord("B", "2")])]
    [1.5, 0.5]
    >>> [round(a / np.pi, 3) for a in angles([BladeRecord("A", slot="3"), BladeRecord("B", "0")])]
    [1.5, 0.0]
    >>> [round(a / np.pi, 3) for a in angles([BladeRecord("A", slot="4"), BladeRecord("B")])]
    [0.0, 1.0]
    """
    everyone = blades if everyone is None else everyone
    numbers = {b.id: n for b in everyone if (n := _number(b.slot)) is not None}
    running = [b for b in everyone if b.retired_seq is None]
    fit = all(b.id in numbers for b in (*running, *blades))
    fit = fit and len({numbers[b.id] for b in running}) == len(running)
    if not fit:
        numbers = {b.id: i for i, b in enumerate(everyone, start=1)}
    first = 0 if 0 in numbers.values() else 1
    count = max(numbers.values(), default=1) - first + 1
    return [2 * np.pi * (numbers[b.id] - first) / count for b in blades]


def _number(slot: str | None) -> int | None:
    """The slot as a number; None: it is called otherwise."""
    if slot is None or not (slot.isascii() and slot.isdigit() and len(slot) <= 3):
        return None
    return int(slot) if int(slot) <= MOST_SLOTS else None


def turned(values: Array, angle: float) -> Array:
    """Points or vectors (N, 3) turned around x.

    >>> turned(np.array([[5.0, 0.0, 2.0]]), np.pi / 2).round(9).tolist()
    [[5.0, -2.0, 0.0]]
    """
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(values @ np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]]))
