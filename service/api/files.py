"""Answers as files, by ``?format=``: what a route can be asked for, and how a file is answered."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from fastapi.responses import Response, StreamingResponse

from service.api.tags import REVALIDATE
from service.export.sensorthings import MEDIA
from service.handlers.reads import Basis, health

NETCDF, PARQUET = "application/x-netcdf", "application/vnd.apache.parquet"
CSV, VTU = "text/csv; charset=utf-8", "application/xml"
SENSORTHINGS, ZIP, NPZ = MEDIA, "application/zip", "application/x-npz"
ARROW = "application/vnd.apache.arrow.stream"
BLADE = "/v1/rotors/{r}/blades/{b}"
FILES: dict[str, tuple[str, ...]] = {
    "GET /v1/rotors/{r}/inspections": (CSV, PARQUET, SENSORTHINGS),
    "GET /v1/rotors/{r}/posterior": (NETCDF,),
    f"GET {BLADE}/posterior": (NETCDF,),
    "GET /v1/rotors/{r}/draws": (NETCDF,),
    f"GET {BLADE}/draws": (NETCDF,),
    f"GET {BLADE}/field": (VTU, ZIP, NPZ, ARROW),
    "GET /v1/rotors/{r}/field": (ZIP,),
    f"GET {BLADE}/prediction": (CSV, SENSORTHINGS),
}
"""Media types that a route answers with besides JSON; `service.api.describe` tells them."""


def contents(name: str) -> dict[str, Any]:
    """The files of a route, as an OpenAPI document has them: bytes, so without a schema."""
    return {kind.partition(";")[0]: {} for kind in FILES.get(name, ())}


def file(
    body: bytes | Iterable[str] | Iterable[bytes],
    kind: str,
    name: Iterable[object],
    ending: str,
    tag: str,
    found: Basis | None = None,
) -> Response:
    """A file with its ETag and a name to save it under; `found`: the version that it rests on.

    body   the bytes, or pieces as they come
    """
    saved = "-".join(str(part) for part in name).replace(":", "_")
    headers = {
        "ETag": tag,
        "Cache-Control": REVALIDATE,
        "Content-Disposition": f'attachment; filename="{saved}.{ending}"',
    }
    if found is not None:
        headers["Bladetwin-Health"] = health(found.state)["status"]
    if isinstance(body, bytes):
        return Response(body, media_type=kind, headers=headers)
    return StreamingResponse(body, media_type=kind, headers=headers)
