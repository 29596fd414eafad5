"""The body of `POST /v1/models`: JSON for a built-in model, a form for runs of a user's own.

A form (multipart) carries the archive and the network in one request, so that they are stored
together or not at all; curl and every HTTP library write it. Its parts are counted and limited, and
files above a megabyte wait on the disk, not in memory. Networks are read here, since that is quick
and says at once what is wrong; the archive is read by the job.
"""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from typing import Any

from fastapi import Request
from pydantic import ValidationError
from pydantic_core import from_json
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import FormData, UploadFile
from starlette.exceptions import HTTPException

from core.errors import FaultsError, InputError
from core.network import Network
from service.api.problems import RequestError, faults_of_validation, invalid
from service.api.schemas import ModelIn
from service.declared import read_network
from service.names import ID_PATTERN, unlisted

FIELDS = ("id", "network", "runs", "leave_out")
TEXT_BYTES = 2**20
MOST_LEFT_OUT = 10_000
BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            "application/json": {"schema": ModelIn.model_json_schema()},
            "multipart/form-data": {
                "schema": {
                    "type": "object",
                    "required": ["id", "network", "runs"],
                    "additionalProperties": False,
                    "properties": {
                        "id": {"type": "string", "maxLength": 100, "pattern": ID_PATTERN},
                        "network": {
                            "type": "string",
                            "description": "the declaration in YAML or JSON, as text or as a file",
                        },
                        "runs": {
                            "type": "string",
                            "format": "binary",
                            "description": "netCDF-4, as `Your own runs` of core/README.md says",
                        },
                        "leave_out": {
                            "type": "string",
                            "description": "labels of runs to leave out, with commas between; "
                            "one that holds a comma in double quotes",
                        },
                    },
                },
            },
        },
    }
}


@dataclass(frozen=True, slots=True)
class Upload:
    """Runs to train a model on, checked as far as that needs no look into the archive."""

    id: str
    network: Network
    runs: bytes
    leave_out: tuple[str, ...]


async def asked_of(request: Request) -> Upload | str:
    """What a request asks for: an upload, or the name of a built-in model.

    Raises RequestError or FaultsError with every fault.
    """
    kind = request.headers.get("content-type", "").split(";")[0].strip().lower()
    if kind == "multipart/form-data":
        return await _upload(request)
    if kind not in ("", "application/json"):
        text = f"{kind!r} is not read; post application/json or multipart/form-data"
        raise RequestError(415, "unsupported-media-type", text)
    try:
        data = from_json(await request.body(), allow_inf_nan=True)
    except ValueError as error:
        raise RequestError(400, "invalid-json", f"the body is not JSON: {error}") from None
    try:
        return ModelIn.model_validate(data).builtin
    except ValidationError as error:
        raise invalid(faults_of_validation(error.errors(), ModelIn)) from None


async def _upload(request: Request) -> Upload:
    try:
        form = await request.form(max_files=4, max_fields=16, max_part_size=TEXT_BYTES)
    except HTTPException as error:
        text = f"the body is no form (multipart): {error.detail}"
        raise RequestError(400, "invalid-form", text) from None
    except (LookupError, UnicodeError):
        text = "the body is no form (multipart): its charset is not known. To mend it: use UTF-8"
        raise RequestError(400, "invalid-form", text) from None
    try:
        texts = {name: await _content(form, name) for name in FIELDS if name in form}
        return await run_in_threadpool(_checked, form, texts)
    finally:
        await form.close()


async def _content(form: FormData, name: str) -> bytes:
    found = form[name]
    return await found.read() if isinstance(found, UploadFile) else found.encode("utf-8", "replace")


def _checked(form: FormData, told: dict[str, bytes]) -> Upload:
    faults: list[InputError] = []
    names = [name for name, _ in form.multi_items()]
    for name in sorted(set(names)):
        if name not in FIELDS:
            remedy = f"send {', '.join(FIELDS)}"
            faults.append(InputError(name[:100], "…", "is no part of the form", remedy))
        elif names.count(name) > 1:
            faults.append(InputError(name, names.count(name), "comes more than once", "send one"))
    for name in ("id", "network", "runs"):
        if name not in told:
            faults.append(InputError(name, None, "is missing", "send it as a part of the form"))
    model = told.get("id", b"x").decode("utf-8", "replace")
    if not re.fullmatch(ID_PATTERN, model) or len(model) > 100:
        remedy = "use letters, digits and . _ : @ + - (no slash, no space), 100 at most"
        faults.append(InputError("id", model[:100], "is no id", remedy))
    network = None
    if "network" in told:
        try:
            network = read_network(told["network"])
        except FaultsError as error:
            faults += error.faults
    left: tuple[str, ...] = ()
    try:
        left = unlisted(told.get("leave_out", b"").decode("utf-8", "replace"))
    except csv.Error as error:
        remedy = "write labels with commas between, one that holds a comma in double quotes"
        faults.append(InputError("leave_out", "…", f"cannot be read: {error}", remedy))
    if len(left) > MOST_LEFT_OUT:
        problem = f"labels are more than {MOST_LEFT_OUT}"
        faults.append(InputError("leave_out", len(left), problem, "leave them out of the archive"))
    if faults or network is None:
        raise FaultsError(faults)
    return Upload(model, network, told["runs"], left)
