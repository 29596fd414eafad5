"""Routes of the pages and of the files that they need.

The names in a page's path are put into the shell escaped, and are looked up by the page's script
alone: whether a rotor exists is not told by its page.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from typing import Any

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse, Response
from jinja2 import Environment, FileSystemLoader
from starlette.exceptions import HTTPException

from service.api.tags import same_tag

HERE = Path(__file__).parent
STATIC = HERE / "static"
KINDS = {
    ".js": "text/javascript",
    ".css": "text/css",
    ".svg": "image/svg+xml",
    ".LICENSE": "text/plain",
}
PAGES = {
    "/": ("Rotors", "rotors"),
    "/rotors/{r}": ("Rotor", "rotor"),
    "/rotors/{r}/readings": ("Readings", "readings"),
    "/rotors/{r}/blades/{b}": ("Blade", "blade"),
    "/rotors/{r}/blades/{b}/3d": ("Blade in 3-D", "space"),
    "/rotors/{r}/residuals": ("Residuals", "residuals"),
    "/rotors/{r}/diagnoses": ("Diagnoses", "diagnoses"),
    "/rotors/{r}/diagnoses/{d}": ("Diagnosis", "diagnosis"),
    "/models": ("Models", "models"),
    "/models/{m}": ("Model", "model"),
    "/operations": ("Operations", "operations"),
}
"""Path of each page: its title and the script that fills it."""

ASSET = "/assets/{name:path}"
router = APIRouter(include_in_schema=False)
shells = Environment(loader=FileSystemLoader(HERE / "templates"), autoescape=True, trim_blocks=True)


@dataclass(frozen=True, slots=True)
class Asset:
    """A file as it is sent."""

    body: bytes
    kind: str
    tag: str


@lru_cache(maxsize=1)
def assets() -> dict[str, Asset]:
    """Every file below `static`, by its path there; no other path leads to a file."""
    found = {}
    for path in sorted(STATIC.rglob("*")):
        if path.is_file() and path.suffix in KINDS:
            body = path.read_bytes()
            tag = f'"{sha256(body).hexdigest()[:32]}"'
            found[path.relative_to(STATIC).as_posix()] = Asset(body, KINDS[path.suffix], tag)
    return found


@router.get(ASSET)
def get_asset(name: str, request: Request) -> Response:
    """A script, style or picture of the pages."""
    found = assets().get(name)
    if found is None:
        raise HTTPException(404)
    headers = {"ETag": found.tag, "Cache-Control": "public, no-cache"}
    known = same_tag(request.headers.get("if-none-match", ""), found.tag)
    if known is not None:
        return Response(status_code=304, headers=headers | {"ETag": known})
    return Response(found.body, media_type=found.kind, headers=headers)


def shell(path: str) -> Any:
    """The route of one page."""
    title, script = PAGES[path]

    def page(request: Request) -> HTMLResponse:
        names = dict(request.path_params)
        text = shells.get_template("page.html").render(title=title, script=script, names=names)
        tag = f'"{sha256(text.encode()).hexdigest()[:32]}"'
        headers = {"ETag": tag, "Cache-Control": "public, no-cache"}
        if (known := same_tag(request.headers.get("if-none-match", ""), tag)) is not None:
            return HTMLResponse(status_code=304, headers=headers | {"ETag": known})
        return HTMLResponse(text, headers=headers)

    return page


for _path in PAGES:
    router.add_api_route(_path, shell(_path), methods=["GET"], name=f"page {_path}")
