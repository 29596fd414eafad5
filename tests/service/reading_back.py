"""Files as the named tools read them."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any


def arviz() -> Any:
    """ArviZ, whose import says that version 1.0 is another one."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import arviz as found
    return found


def opened(body: bytes, tmp_path: Path) -> Any:
    """Draws as ArviZ opens them."""
    file = tmp_path / "draws.nc"
    file.write_bytes(body)
    return arviz().from_netcdf(str(file))
