"""``bladetwin export --format …``: the files of the API's ``?format=``, from the database itself.

The bytes are those that the service would answer; no service need run. A file gets its name when it
is whole.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

from core.errors import InputError
from service.progress import bar
from service.settings import Settings

if TYPE_CHECKING:
    from service.ports import Science
    from service.store.unit_of_work import SqlStore


class Form(StrEnum):
    """What a file is."""

    BUNDLE = "bundle"
    CSV = "csv"
    PARQUET = "parquet"
    SENSORTHINGS = "sensorthings"
    NETCDF = "netcdf"
    VTU = "vtu"
    PVD = "pvd"
    NPZ = "npz"
    ARROW = "arrow"


@dataclass(frozen=True, slots=True)
class Wanted:
    """What is asked for; None and False: not said."""

    form: Form
    blade: str | None = None
    prediction: bool = False
    quantity: str | None = None
    times: str | None = None
    count: int | None = None
    version: int | None = None

    @property
    def given(self) -> set[str]:
        names = ("blade", "quantity", "times", "count", "version")
        said = {name for name in names if getattr(self, name) is not None}
        return said | ({"prediction"} if self.prediction else set())


READINGS = {"blade", "prediction"}
PREDICTION = {"blade", "prediction", "quantity", "times", "version"}
FIELD = {"blade", "quantity", "times", "version"}
TAKES = {
    Form.BUNDLE: set[str](),
    Form.CSV: READINGS,
    Form.PARQUET: {"blade"},
    Form.SENSORTHINGS: READINGS,
    Form.NETCDF: {"blade", "count", "version"},
    Form.VTU: FIELD,
    Form.PVD: FIELD,
    Form.NPZ: FIELD,
    Form.ARROW: FIELD,
}
OF_A_BLADE = (Form.VTU, Form.NPZ, Form.ARROW)


def check(wanted: Wanted) -> None:
    """Refuse an option that the format has no use for, and one that is missing."""
    takes = PREDICTION if wanted.prediction and "prediction" in TAKES[wanted.form] else None
    takes = TAKES[wanted.form] if takes is None else takes
    if odd := sorted(wanted.given - takes):
        use = ", ".join(f"--{name}" for name in sorted(takes)) or "none of them"
        remedy = f"with --format {wanted.form.value} use {use}"
        if "prediction" in takes and not wanted.prediction:
            remedy += "; --quantity, --times and --version belong to a --prediction"
        problem = f"is not for --format {wanted.form.value}"
        raise InputError(f"--{odd[0]}", getattr(wanted, odd[0]), problem, remedy)
    if wanted.blade is None and (wanted.prediction or wanted.form in OF_A_BLADE):
        raise InputError("--blade", None, "is missing", "name the blade")


def write(store: SqlStore, settings: Settings, rotor: str, wanted: Wanted, file: Path) -> None:
    """The file, whole or not at all."""
    from service.bootstrap import make_science

    part = file.with_name(f".{file.name}.{os.getpid()}.part")
    try:
        with part.open("wb") as out:
            for piece in pieces(store, make_science(settings, store), rotor, wanted):
                out.write(piece.encode() if isinstance(piece, str) else piece)
            out.flush()
            os.fsync(out.fileno())
        part.replace(file)
    except OSError as error:
        problem = f"cannot be written: {error.strerror}"
        raise InputError("FILE", str(file), problem, "check folder and disk") from None
    finally:
        part.unlink(missing_ok=True)


def pieces(
    store: SqlStore, science: Science, rotor: str, wanted: Wanted
) -> Iterable[str] | Iterable[bytes]:
    """The content of the file as it comes."""
    from service.handlers import exports
    from service.handlers.listing import log_now

    if wanted.prediction:
        return _prediction(store, science, rotor, wanted)
    if wanted.form is Form.CSV:
        return exports.readings_csv(store, log_now(store, rotor, wanted.blade), wanted.blade)
    if wanted.form is Form.SENSORTHINGS:
        return exports.sensorthings(store, log_now(store, rotor, wanted.blade), wanted.blade)
    if wanted.form is Form.PARQUET:
        return [exports.readings_parquet(store, log_now(store, rotor, wanted.blade), wanted.blade)]
    if wanted.form is Form.NETCDF:
        return _draws(store, science, rotor, wanted)
    return _field(store, science, rotor, wanted)


def _prediction(store: SqlStore, science: Science, rotor: str, wanted: Wanted) -> Iterator[bytes]:
    from service.export import sensorthings
    from service.export.tables import prediction_csv
    from service.handlers import reads
    from service.handlers.questions import question
    from service.moments import moment
    from service.ports import Which

    found = reads.basis(store, science, rotor, Which(wanted.version), wanted.blade)
    asked = question(found.card, wanted.quantity, hours(wanted.times), None, 0.95)
    told = reads.predict(store, science, found, asked)
    body = {"rotor": rotor} | told | {"rests_on": found.to_json()}
    if wanted.form is Form.CSV:
        yield prediction_csv(body)
        return
    made = sensorthings.predicted(body, moment(found.state.created_at))
    yield json.dumps(made, ensure_ascii=False).encode()


def _draws(store: SqlStore, science: Science, rotor: str, wanted: Wanted) -> Iterator[bytes]:
    from service.handlers import exports, glance, reads
    from service.ports import Which

    found = reads.basis(store, science, rotor, Which(wanted.version), wanted.blade)
    count = 1000 if wanted.count is None else wanted.count
    if found.blade is None:
        drawn, blades = exports.rotor_draws(store, science, found, count, "netcdf")
    else:
        one = glance.draws(store, science, found, count)
        drawn = exports.of_one_blade(one, found, science, store)
        blades = [found.blade]
    yield exports.draws_netcdf(store, science, drawn, blades, found)


def _field(store: SqlStore, science: Science, rotor: str, wanted: Wanted) -> Iterator[bytes]:
    from service.handlers import exports, glance, reads, series
    from service.ports import Which

    found = reads.basis(store, science, rotor, Which(wanted.version), wanted.blade)
    times = hours(wanted.times)
    if wanted.form is Form.VTU:
        if times is not None and len(times) != 1:
            raise InputError("--times", wanted.times, "is not one hour", "take --format pvd")
        one = times[0] if times else None
        name, hour = glance.field_question(found.card, wanted.quantity, one)
        told = glance.field(store, science, found, name, hour)
        yield exports.field_vtu(store, science, found, told)
        return
    if found.blade is None:
        asked = series.of_rotor(store, found, wanted.quantity, times, None)
    else:
        asked = series.asked(found, wanted.quantity, times)
    with bar("fields", asked.count) as done:
        asked = replace(asked, done=done)
        if wanted.form is Form.NPZ:
            yield from series.npz(store, science, found, asked)
        elif wanted.form is Form.ARROW:
            yield from series.arrow(store, science, found, asked)
        else:
            mesh = series.mesh_of(science, found)
            yield from series.pvd(store, science, found, asked, mesh, ring=found.blade is None)


def hours(text: str | None) -> list[float] | None:
    """Hours with commas between. InputError: one is no number.

    >>> hours("0, 8000,2.5e4")
    [0.0, 8000.0, 25000.0]
    """
    if text is None:
        return None
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise InputError("--times", text, "are not hours", "e.g. --times 8000,24000") from None
