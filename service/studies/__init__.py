"""The commands `bladetwin study …`: long statistical checks with results that are kept.

A result is a folder with a JSON file (command, seed, commit, model and every figure) and its plots;
those of a release lie under ``tests/claims/results/``. The tests run a short version of each.
"""

from __future__ import annotations

import typer

from service.studies.result import commit

app = typer.Typer(help="Statistical studies.", no_args_is_help=True)

from service.studies import adaptive as adaptive  # noqa: E402
from service.studies import commands as commands  # noqa: E402  (they register with `app`)
from service.studies import effects as effects  # noqa: E402
from service.studies import histories as histories  # noqa: E402
from service.studies import lives as lives  # noqa: E402
from service.studies import power as power  # noqa: E402
from service.studies import reduction as reduction  # noqa: E402
from service.studies import references as references  # noqa: E402
from service.studies import slips as slips  # noqa: E402
from service.studies import stated as stated  # noqa: E402
from service.studies.chaos import commands as chaos  # noqa: E402
from service.studies.contest import commands as contest  # noqa: E402
from service.studies.load import commands as load  # noqa: E402
from service.studies.paper import commands as paper  # noqa: E402

__all__ = [
    "adaptive", "app", "chaos", "commit", "contest", "effects", "histories", "lives", "load",
    "paper", "power", "reduction", "slips", "stated",
]  # fmt: skip
