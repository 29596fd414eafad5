"""A trained model as one file: ``arrays.npz`` and ``manifest.json`` (`core.surrogate.artefact`) and
the network, ``network.json``, in a zip without compression; and from there back.

The zip is made of fixed names, times and order, so that the same model gives the same bytes. Only
these three names are read, each up to what its directory says; the artefact's own digest guards the
numbers.
"""

from __future__ import annotations

import json
import shutil
import tempfile
import zipfile
from io import BytesIO
from pathlib import Path

from core.errors import ModelError
from core.model import Model
from core.network import Network
from core.surrogate.artefact import ARRAYS, MANIFEST, load

NETWORK = "network.json"
MEMBERS = (ARRAYS, MANIFEST, NETWORK)
EPOCH = (1980, 1, 1, 0, 0, 0)
MOST_BYTES = 4 * 2**30


def write_network(folder: Path, network: Network) -> None:
    """Put the network beside the artefact in `folder`."""
    (folder / NETWORK).write_text(json.dumps(network.to_json(), indent=1) + "\n")


def pack(folder: str | Path) -> bytes:
    """The file of a model in a folder; ModelError where it holds none."""
    folder, out = Path(folder), BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_STORED) as packed:
        for name in MEMBERS:
            try:
                data = (folder / name).read_bytes()
            except OSError as error:
                raise ModelError(f"{folder} holds no trained model: {name} is missing") from error
            packed.writestr(zipfile.ZipInfo(name, EPOCH), data)
    return out.getvalue()


def unpack(data: bytes) -> Model:
    """The model of such a file; ModelError where it is damaged."""
    with tempfile.TemporaryDirectory(prefix="bladetwin-model-") as name:
        folder = Path(name)
        try:
            with zipfile.ZipFile(BytesIO(data)) as packed:
                infos = {info.filename: info for info in packed.infolist()}
                size = sum(info.file_size for info in infos.values())
                if set(infos) != set(MEMBERS) or size > MOST_BYTES:
                    raise ModelError("the stored model has not the members of one: upload it again")
                for member in MEMBERS:
                    with packed.open(member) as source, open(folder / member, "wb") as target:
                        shutil.copyfileobj(source, target)
        except (zipfile.BadZipFile, EOFError, NotImplementedError, RuntimeError) as error:
            raise ModelError(f"the stored model cannot be read: {error}") from error
        return opened(folder)


def opened(folder: Path) -> Model:
    """The model in a folder; ModelError where it is damaged or no network is beside it."""
    surrogate = load(folder)
    try:
        network = Network.from_json(json.loads((folder / NETWORK).read_text()))
    except (OSError, ValueError) as error:
        raise ModelError(f"{folder} holds no readable {NETWORK}: {error}") from error
    return Model.of(network, surrogate)
