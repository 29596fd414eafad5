"""The artefact: ``arrays.npz`` and ``manifest.json`` in one directory.

No pickle: arrays are loaded with ``allow_pickle=False``, everything else is JSON. The manifest
holds a schema number, what is needed to read the arrays (``structure``), where the model comes
from and how well it did, and the digest: SHA-256 over ``structure`` and over name, type, shape and
bytes of every array, modes in single precision however they are stored (`core.surrogate.compact`).
`load` recomputes it and refuses what differs. The digest says which numbers
predict; notes on provenance and errors may be added to a manifest without changing it.

So that a changed note is noticed, too, the manifest has a second digest, `whole`: SHA-256 over
everything else in it. It names nothing, and is in no surrogate's manifest. A manifest from before
has none and is taken as it is.

Schema 2 has parts whose error has a power of its own (`core.surrogate.part`), which a release that
does not know it would leave out; a surrogate without such parts is written as schema 1.
"""

from __future__ import annotations

import json
import os
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import asdict, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.archive import Input, Quantity
from core.errors import ModelError
from core.surrogate.compact import packed, unpacked
from core.surrogate.kernel import Hyper, SharedGP
from core.surrogate.model import Surrogate
from core.surrogate.part import Part
from core.surrogate.tucker import Factors

SCHEMAS = (1, 2)
ARRAYS, MANIFEST = "arrays.npz", "manifest.json"
WHOLE = "whole"
EARLY_H = 1.0  # of a part that tells none
Arrays = dict[str, NDArray[Any]]
_PROCESS = ("z", "weights", "beta", "whiten", "trend", "h_solve")


def _unpack(model: Surrogate) -> tuple[dict[str, Any], Arrays]:
    arrays: Arrays = {"time_h": model.time_h, "points": model.points}
    arrays |= {f"process/{name}": getattr(model.process, name) for name in _PROCESS}
    parts = {}
    for name, part in model.parts.items():
        factors = part.factors
        arrays |= {
            f"{name}/space": factors.space,
            f"{name}/time": factors.time,
            f"{name}/time_h": factors.time_h,
            f"{name}/core": factors.core,
            f"{name}/left_out": part.left_out,
            f"{name}/cut_time": part.cut_time,
            f"{name}/cut_space": part.cut_space,
        }
        columns = [part.columns.start, part.columns.stop]
        parts[name] = {"form": part.form, "columns": columns, "inflation": part.inflation}
        if factors.early_h != EARLY_H:
            parts[name]["early_h"] = factors.early_h
        if part.power != 1.0:
            parts[name]["power"] = part.power
    structure: dict[str, Any] = {
        "inputs": [asdict(item) for item in model.inputs],
        "quantities": [asdict(quantity) for quantity in model.quantities.values()],
        "named": dict(model.named),
        "hyper": asdict(model.process.hyper),
        "parts": parts,
        "v_typical": model.v_typical,
    }
    if model.cells is not None:
        structure["cells"], arrays["cells"] = model.cells
    return json.loads(json.dumps(structure)), arrays


def _digest(structure: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> str:
    total = sha256(json.dumps(structure, sort_keys=True).encode())
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        total.update(f"{name}|{array.dtype.str}|{array.shape}".encode())
        total.update(array.data)
    return total.hexdigest()


def whole_of(manifest: Mapping[str, Any], but: str = WHOLE) -> str:
    """SHA-256 over everything in a manifest but one entry, in whatever order and spacing."""
    rest = {name: value for name, value in manifest.items() if name != but}
    return sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()


def digest_of(model: Surrogate) -> str:
    """SHA-256 of a surrogate's content."""
    return _digest(*_unpack(model))


def save(model: Surrogate, directory: str | Path) -> Surrogate:
    """Write the artefact; the surrogate returned carries its digest and full manifest."""
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    structure, arrays = _unpack(model)
    own = ("schema", "digest", WHOLE, "structure")
    notes = {k: v for k, v in model.manifest.items() if k not in own}
    digest = _digest(structure, arrays)
    schema = SCHEMAS[any(part.power != 1.0 for part in model.parts.values())]
    manifest = {"schema": schema, "digest": digest, **notes, "structure": structure}
    part = directory / f".{ARRAYS}.part"
    small = packed(arrays)
    write = np.savez if small.keys() == arrays.keys() else np.savez_compressed
    with open(part, "wb") as handle:
        write(handle, allow_pickle=False, **small)
    os.replace(part, directory / ARRAYS)
    part = directory / f".{MANIFEST}.part"
    kept = {"schema": schema, "digest": digest, WHOLE: whole_of(manifest)} | manifest
    part.write_text(json.dumps(kept, indent=1) + "\n")
    os.replace(part, directory / MANIFEST)
    return replace(model, manifest=manifest, digest=digest)


def load(directory: str | Path, whole: str | None = None) -> Surrogate:
    """Read an artefact; a missing, damaged or foreign one is a ModelError.

    whole   the manifest's digest (`whole_of`) where it is known from elsewhere
    """
    directory = Path(directory)
    try:
        manifest = json.loads((directory / MANIFEST).read_text())
    except (OSError, ValueError) as error:
        raise ModelError(f"{directory} holds no readable {MANIFEST}: {error}") from error
    if not isinstance(manifest, dict) or manifest.get("schema") not in SCHEMAS:
        raise ModelError(f"{directory}: the artefact's schema is neither 1 nor 2: train it again")
    try:
        with open(directory / ARRAYS, "rb") as handle:
            stored = np.load(handle, allow_pickle=False)
            arrays = unpacked({name: stored[name] for name in stored.files})
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise ModelError(f"{directory} holds no readable {ARRAYS}: {error}") from error
    found = _digest(manifest.get("structure", {}), arrays)
    if found != manifest.get("digest"):
        raise ModelError(
            f"{directory} is damaged: its content has digest {found[:12]}…, the manifest says "
            f"{str(manifest.get('digest'))[:12]}…. Fetch or train it again"
        )
    _check_whole(directory, manifest, whole)
    manifest.pop(WHOLE, None)
    for array in arrays.values():
        array.flags.writeable = False
    return _pack(manifest, arrays)


def _check_whole(directory: Path, manifest: Mapping[str, Any], known: str | None) -> None:
    """ModelError where a note is not what was written."""
    found, told = whole_of(manifest), manifest.get(WHOLE)
    if told is None:  # from before; or it has lost its name
        renamed = (name for name, value in manifest.items() if value == whole_of(manifest, name))
        told = next((f"{name}=…" for name in renamed), None)
    for said, where in ((told, "it"), (known, "this release")):
        if said not in (None, found):
            raise ModelError(
                f"{directory} is damaged: its {MANIFEST} has digest {found[:12]}…, {where} says "
                f"{str(said)[:12]}…: a note on errors or provenance was changed. Fetch or train it "
                "again"
            )


def _pack(manifest: dict[str, Any], arrays: Arrays) -> Surrogate:
    structure = manifest["structure"]
    hyper = Hyper(**structure["hyper"] | {"lengths": tuple(structure["hyper"]["lengths"])})
    parts = {}
    for name, one in structure["parts"].items():
        own = {key: arrays[f"{name}/{key}"] for key in ("space", "time", "time_h", "core")}
        parts[name] = Part(
            one["form"],
            Factors(**own, early_h=one.get("early_h", EARLY_H)),
            slice(*one["columns"]),
            arrays[f"{name}/left_out"],
            arrays[f"{name}/cut_time"],
            arrays[f"{name}/cut_space"],
            one["inflation"],
            one.get("power", 1.0),
        )
    process = SharedGP(hyper=hyper, **{name: arrays[f"process/{name}"] for name in _PROCESS})
    cells = (structure["cells"], arrays["cells"]) if "cells" in structure else None
    return Surrogate(
        inputs=tuple(Input(**item) for item in structure["inputs"]),
        time_h=arrays["time_h"],
        quantities={item["name"]: Quantity(**item) for item in structure["quantities"]},
        points=arrays["points"],
        named=structure["named"],
        process=process,
        parts=parts,
        v_typical=structure["v_typical"],
        cells=cells,
        manifest=manifest,
        digest=manifest["digest"],
    )
