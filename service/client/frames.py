"""Readings, beliefs and residuals as frames of pandas and data sets of xarray.

Every page is read. Where the rotor moves on between two pages, so that their rows would not rest
on the same version, they are read anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from core.errors import BladetwinError
from service.client import beliefs, files, framed
from service.client import readings as of_readings
from service.client import rotors as of_rotors
from service.client.steps import Call, Json, Steps, checked, path, told

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset

RESTS_ON = ("rests_on", "as_of")
MOST_TRIES = 10


def collected(first: Call) -> Steps[Json]:
    """The first page with the items of all.

    Raises BladetwinError where no two tries found the rotor at rest.
    """
    for _ in range(MOST_TRIES):
        whole: Json = {}
        asked = first
        while True:
            page = checked((yield asked)).json()
            if whole and any(page.get(name) != whole.get(name) for name in RESTS_ON):
                break
            whole = page | {"items": whole.get("items", []) + page["items"]}
            if page["next"] is None:
                return whole
            asked = replace(first, params={**first.params, "cursor": page["next"]})
    raise BladetwinError(
        f"{first.path} changed {MOST_TRIES} times while its pages were read. "
        "To mend it: ask for a version, or when fewer readings come."
    )


def readings_frame(rotor: str, *, blade: str | None = None) -> Steps[DataFrame]:
    """Every reading, counting or not, as a pandas.DataFrame in the order of arrival.

    Columns: id, blade, quantity, time_h [h], value [unit], unit, sigma, count, node, instrument,
    campaign, observed_at, replaces, status, late, seq, received_at, posted_by. A scan is one row
    too: its `count` nodes and NaN for a value; `inspection` gives it whole. `late`: it came after
    a reading of the same blade at later hours.
    """
    whole = yield from collected(of_readings.inspections(rotor, blade=blade))
    frame = framed.readings(whole["items"])
    frame.attrs = {"rotor": rotor}
    return frame


def prediction_frame(
    rotor: str,
    blade: str,
    quantity: str | None = None,
    *,
    times: Sequence[float] | None = None,
    node: int | str | None = None,
    probability: float = 0.95,
    instrument: str | None = None,
    version: int | None = None,
    at: str | None = None,
) -> Steps[DataFrame]:
    """The bands of `prediction` as a pandas.DataFrame by time_h [h].

    Columns [unit]: mean, lower, upper, sd (in total), sd_parameters, sd_surrogate,
    sd_discrepancy, sd_noise; of a vector with a second level, ``frame["mean"]["z"]``. `attrs`:
    unit, quantity, probability, health, rests_on and what else the answer says.
    """
    answer = yield from beliefs.prediction(
        rotor,
        blade,
        quantity,
        times=times,
        node=node,
        probability=probability,
        instrument=instrument,
        version=version,
        at=at,
    )
    return framed.prediction(answer)


def blades_frame(
    rotor: str,
    *,
    quantity: str | None = None,
    time_h: float | None = None,
    node: int | str | None = None,
    version: int | None = None,
    at: str | None = None,
) -> Steps[DataFrame]:
    """Every blade at one hour as a pandas.DataFrame by blade.

    Columns: slot, lot, coating_lot, installed_at, time_h0, added_seq, retired, counting,
    overruled, last_id, last_time_h, last_received_at, known_<input>, and of the prediction [unit]
    mean, sd (of a reading), sd_blade (of the blade itself), sd_<source>; of a vector mean_x, ….

    time_h   hour of the prediction [h]; None: the model's last
    """
    first = of_rotors.blades(
        rotor, quantity=quantity, time_h=time_h, node=node, version=version, at=at
    )
    return framed.blades((yield from collected(first)))


def residuals_frame(
    rotor: str,
    *,
    blade: str | None = None,
    quantity: str | None = None,
    campaign: str | None = None,
) -> Steps[DataFrame]:
    """Every reading as it was foreseen before it was used, as a pandas.DataFrame.

    Columns: inspection, blade, quantity, campaign, instrument, time_h and rotor_h [h], visit,
    part (component of a vector), y, mean, sd, z, pit. `attrs`: tests, alarms, as_of, pending (the
    newest posterior is another one than they rest on) and what else the answer says.
    """
    params = told(blade=blade, quantity=quantity, campaign=campaign)
    first = Call("GET", path("rotors", rotor, "residuals"), params)
    return framed.residuals((yield from collected(first)))


def draws_frame(
    rotor: str,
    blade: str | None = None,
    *,
    count: int | None = None,
    version: int | None = None,
    at: str | None = None,
) -> Steps[DataFrame]:
    """Equally weighted draws as a pandas.DataFrame with a column for each parameter.

    Of a blade: rows by draw. Jointly of all blades: rows by (draw, blade), where the blades of a
    draw share what is shared. `attrs`: units and level (shared, local) of the parameters, health.
    """
    body = yield from files.draws_netcdf(
        rotor, blade, count=count, version=version, at=at, groups=()
    )
    return framed.draws(body, joint=blade is None)


def field_xarray(
    rotor: str,
    blade: str,
    quantity: str | None = None,
    *,
    times: Sequence[float] | None = None,
    version: int | None = None,
    at: str | None = None,
) -> Steps[Dataset]:
    """A field over hours as an xarray.Dataset: `mean` and `sd` (time_h, node[, axis]).

    times    [h], rising; None: the model's instants
    """
    answer: Any = yield from files.field_series(
        rotor, blade, quantity, times=times, version=version, at=at
    )
    return framed.field(answer)
