"""Files that ``bladetwin diagnose`` reads and writes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from core.errors import InputError

Told = dict[str, Any]


def read_families(file: Path) -> list[Told]:
    """A list of families, or ``{"families": […]}``. InputError: it is neither."""
    try:
        told = json.loads(file.read_text())
    except (OSError, ValueError) as error:
        raise InputError(
            "--families", str(file), f"cannot be read: {error}", "give a JSON file"
        ) from None
    told = told.get("families") if isinstance(told, dict) else told
    if not isinstance(told, list) or not all(isinstance(one, dict) for one in told):
        remedy = "see `Asking for a diagnosis` in service/README.md"
        raise InputError("--families", str(file), "holds no list of families", remedy)
    return told


def write(file: Path, page: str) -> None:
    """A report to its file. InputError: it cannot be written."""
    try:
        file.write_text(page, encoding="utf-8")
    except OSError as error:
        raise InputError(
            "--html", str(file), f"cannot be written: {error}", "name another"
        ) from None
