"""A rotor as one file: a zip of JSON lines with a manifest of their digests; no pickle.

::

    manifest.json   format, schema, release, rotor, model, head_seq, per member its bytes, lines and
                    SHA-256, the newest sealed digests, and the SHA-256 of all that
    rotor.json      id, model, model_version, particles, seed, network, origin, digest, `adopt` and
                    `diagnose` where they are not "never", `created_at`, `policy` where what it
                    does by itself was decided anew
    blades.jsonl    one blade a line, in the order of their ids
    log.jsonl       one entry a line, 1 … head_seq: the columns of the log, with `received_at`, and
                    `posted_by` where it is known; effects that were adopted or backed out are
                    entries like others

`created_at` and `posted_by` came later than the rest. A file without them is read as before: its
rotor is created when it is imported, and who posted its entries is not known.

The same rotor gives the same bytes. A file is checked before anything of it is used: only these
four names, stored or deflated, sizes below limits that are counted while reading, no more than
`MOST_RATIO` times the file's own size, every digest. Nothing is ever written under a name that the
file gives, so a name cannot lead anywhere. A digest guards against damage, not against malice.
"""

from __future__ import annotations

import json
import os
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import IO, Any

from core.errors import ModelError

FORMAT, SCHEMA = "bladetwin-rotor", 1
MIB = 2**20
MEMBERS: Mapping[str, int] = {  # most bytes unpacked
    "manifest.json": MIB,
    "rotor.json": MIB,
    "blades.jsonl": 64 * MIB,
    "log.jsonl": 4096 * MIB,
}
LONGEST_LINE = 64 * MIB
MOST_RATIO, SMALL = 200, 16 * MIB
UNREADABLE = (
    zipfile.BadZipFile,
    zlib.error,
    NotImplementedError,
    RuntimeError,
    EOFError,
    OSError,
    ValueError,
)
EPOCH = (1980, 1, 1, 0, 0, 0)
Json = dict[str, Any]


class BundleError(ModelError):
    """A file that is no rotor of this format, or is damaged: nothing of it was used."""

    def __init__(self, path: str | Path, problem: str) -> None:
        self.path = str(path)
        super().__init__(f"{path}: {problem}; nothing was imported. Export the rotor again.")


def digest_of_manifest(manifest: Mapping[str, Any]) -> str:
    """SHA-256 of all that a manifest says beside it."""
    rest = {key: value for key, value in manifest.items() if key != "sha256"}
    return sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()


def write(
    path: Path, facts: Json, rotor: Json, blades: Iterable[Json], log: Iterable[Json]
) -> Json:
    """Write the file and give its manifest; the file appears whole or not at all."""
    part = path.with_name(f".{path.name}.{os.urandom(4).hex()}.part")
    files: dict[str, Json] = {}
    try:
        with zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as archive:
            for name, rows in (
                ("rotor.json", [rotor]),
                ("blades.jsonl", blades),
                ("log.jsonl", log),
            ):
                files[name] = _write_member(archive, name, rows)
            manifest = {"format": FORMAT, "schema": SCHEMA, **facts, "files": files}
            manifest["sha256"] = digest_of_manifest(manifest)
            _write_member(archive, "manifest.json", [manifest])
        with open(part, "rb") as handle:
            os.fsync(handle.fileno())
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)
    return manifest


def _write_member(archive: zipfile.ZipFile, name: str, rows: Iterable[Json]) -> Json:
    info = zipfile.ZipInfo(name, EPOCH)
    info.compress_type = zipfile.ZIP_DEFLATED
    made, size, lines = sha256(), 0, 0
    with archive.open(info, "w", force_zip64=True) as member:
        for row in rows:
            line = json.dumps(row, separators=(",", ":")).encode() + b"\n"
            member.write(line)
            made.update(line)
            size, lines = size + len(line), lines + 1
    return {"bytes": size, "lines": lines, "sha256": made.hexdigest()}


@dataclass(frozen=True, slots=True)
class Bundle:
    """A file whose members have the sizes and digests that its manifest says."""

    path: str
    manifest: Json
    archive: zipfile.ZipFile

    def rows(self, name: str) -> Iterator[Json]:
        """The objects of a member, one a line."""
        with self.archive.open(name) as member:
            for number, line in enumerate(_lines(self.path, name, member), 1):
                yield _object(self.path, f"{name}, line {number}", line)


def opened(path: Path, handle: IO[bytes]) -> Bundle:
    """The checked file; BundleError says what is wrong with it."""
    try:
        archive = zipfile.ZipFile(handle)
        infos = archive.infolist()
        _check_members(path, infos)
        with archive.open("manifest.json") as member:
            manifest = _object(
                path, "manifest.json", b"".join(_lines(path, "manifest.json", member))
            )
        _check_manifest(path, manifest)
        for name in sorted(MEMBERS.keys() - {"manifest.json"}):
            _check_content(path, archive, name, manifest["files"].get(name))
    except UNREADABLE as error:
        raise BundleError(path, f"it is no readable zip file: {error}") from None
    return Bundle(str(path), manifest, archive)


def _check_members(path: Path, infos: list[zipfile.ZipInfo]) -> None:
    names = [info.filename for info in infos]
    if sorted(names) != sorted(MEMBERS):
        odd = sorted(set(names) ^ set(MEMBERS)) or sorted(n for n in names if names.count(n) > 1)
        raise BundleError(path, f"it has not just the members {', '.join(MEMBERS)}: {odd[:5]}")
    for info in infos:
        if info.flag_bits & 0x1:
            raise BundleError(path, f"{info.filename} is encrypted")
        if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise BundleError(path, f"{info.filename} is packed in another way than deflate")
        if info.file_size > MEMBERS[info.filename]:
            most = MEMBERS[info.filename]
            raise BundleError(path, f"{info.filename} has {info.file_size} bytes, above {most}")
    total = sum(info.file_size for info in infos)
    packed = sum(info.compress_size for info in infos)
    if total > SMALL and total > MOST_RATIO * packed:
        raise BundleError(path, f"{packed} bytes unpack to {total}: more than {MOST_RATIO}-fold")


def _check_manifest(path: Path, manifest: Json) -> None:
    if manifest.get("format") != FORMAT:
        raise BundleError(path, f"its format is {manifest.get('format')!r}, not {FORMAT!r}")
    if manifest.get("schema") != SCHEMA:
        raise BundleError(
            path, f"its schema is {manifest.get('schema')!r}, this release has {SCHEMA}"
        )
    if manifest.get("sha256") != digest_of_manifest(manifest):
        raise BundleError(path, "manifest.json has another SHA-256 than written")
    if not isinstance(manifest.get("files"), dict):
        raise BundleError(path, "manifest.json names no files")


def _check_content(path: Path, archive: zipfile.ZipFile, name: str, told: object) -> None:
    made, size, lines = sha256(), 0, 0
    with archive.open(name) as member:
        for line in _lines(path, name, member):
            made.update(line)
            size, lines = size + len(line), lines + 1
    if told != {"bytes": size, "lines": lines, "sha256": made.hexdigest()}:
        found = f"{size} bytes in {lines} lines with SHA-256 {made.hexdigest()[:12]}…"
        raise BundleError(path, f"{name} has {found}, the manifest says {told}")


def _lines(path: str | Path, name: str, member: IO[bytes]) -> Iterator[bytes]:
    """Lines below the limits, whatever the file's directory says of their size."""
    size = 0
    while line := member.readline(LONGEST_LINE + 1):
        size += len(line)
        if len(line) > LONGEST_LINE or size > MEMBERS[name]:
            raise BundleError(path, f"{name} is longer than {MEMBERS[name]} bytes, or a line of it")
        yield line


def _object(path: str | Path, where: str, line: bytes) -> Json:
    try:
        found = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise BundleError(path, f"{where} is no JSON: {type(error).__name__}") from None
    if not isinstance(found, dict):
        raise BundleError(path, f"{where} is no JSON object")
    return found
