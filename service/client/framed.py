"""Answers as frames of pandas and data sets of xarray: pure functions, without a connection.

Columns are named as the fields of the answers. Texts are pandas' ``string``, moments
``datetime64[us, UTC]``, hours and values float64; what an answer does not have is NA, NaN or NaT.
What holds for all rows (unit, rotor, health, what the numbers rest on) stands in ``frame.attrs``.

pandas and xarray are imported where they are needed: they take a second.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset

Answer = Mapping[str, object]
TEXT, NUMBER, WHOLE, MOMENT = "string", "float64", "int64", "datetime64[us, UTC]"
READINGS = {
    "id": TEXT, "blade": TEXT, "quantity": TEXT, "time_h": NUMBER, "value": NUMBER, "unit": TEXT,
    "sigma": NUMBER, "count": WHOLE, "node": "Int64", "instrument": TEXT, "campaign": TEXT,
    "observed_at": MOMENT, "replaces": TEXT, "status": TEXT, "late": "bool", "seq": WHOLE,
    "received_at": MOMENT, "posted_by": TEXT,
}  # fmt: skip
RESIDUALS = {
    "inspection": TEXT, "blade": TEXT, "quantity": TEXT, "campaign": TEXT, "instrument": TEXT,
    "time_h": NUMBER, "rotor_h": NUMBER, "visit": WHOLE, "part": WHOLE, "y": NUMBER,
    "mean": NUMBER, "sd": NUMBER, "z": NUMBER, "pit": NUMBER,
}  # fmt: skip
BLADES = {
    "blade": TEXT, "slot": TEXT, "lot": TEXT, "coating_lot": TEXT, "installed_at": MOMENT,
    "time_h0": NUMBER, "added_seq": WHOLE, "retired": "bool", "counting": WHOLE,
    "overruled": WHOLE, "last_id": TEXT, "last_time_h": NUMBER, "last_received_at": MOMENT,
    "mean": NUMBER, "sd": NUMBER, "held_from_h": NUMBER,
}  # fmt: skip
LISTS = ("time_h", "mean", "sd", "lower", "upper", "quantiles")
AXES = ("x", "y", "z")
FACTS = (
    *("rotor", "version", "through_seq", "events_digest", "state_digest", "model"),
    *("model_version", "model_digest", "algorithm_version"),
)


def framed(rows: Sequence[Mapping[str, Any]], kinds: Mapping[str, str]) -> DataFrame:
    """Rows as a frame with these columns, whether there are any rows or none."""
    import pandas

    columns = {}
    for name, kind in kinds.items():
        cells = pandas.Series([row.get(name) for row in rows], dtype="object")
        if kind == MOMENT:
            cells = pandas.to_datetime(cells, utc=True, format="ISO8601")
        columns[name] = cells.astype(kind)
    return pandas.DataFrame(columns)


def readings(items: Iterable[Answer]) -> DataFrame:
    """A row for each reading, in the order of arrival.

    value   of a reading that is one number [unit]; NaN of a scan or a vector
    count   how many nodes (or values) it has; `inspection` gives them all
    late    it came after a reading of the same blade at later hours
    """
    rows: list[dict[str, Any]] = []
    latest: dict[str, float] = {}
    for told in sorted(items, key=_seq):
        one: Any = told
        before = latest.get(one["blade"], -np.inf)
        latest[one["blade"]] = max(before, one["time_h"])
        values, nodes = one["values"], one.get("nodes") or []
        alone = values is not None and len(values) == 1
        rows.append(
            dict(one)
            | {
                "value": values[0] if alone and not isinstance(values[0], list) else None,
                "count": one["count"] if values is None else len(values),
                "node": nodes[0] if len(nodes) == 1 else None,
                "late": one["time_h"] < before,
            }
        )
    return framed(rows, READINGS)


def _seq(told: Answer) -> int:
    one: Any = told
    return int(one["seq"])


def prediction(answer: Answer) -> DataFrame:
    """Rows by hour: mean, lower, upper, sd (of a reading, in total) and sd_<source> [unit].

    Columns of a vector have a second level, `component`: ``frame["mean"]["z"]``.
    """
    import pandas

    told: Any = answer
    sd = dict(told["sd"])
    parts = {"mean": told["mean"], "lower": told["lower"], "upper": told["upper"]}
    parts |= {"sd": sd.pop("total")} | {f"sd_{source}": values for source, values in sd.items()}
    arrays = {name: np.asarray(values, dtype=float) for name, values in parts.items()}
    index = pandas.Index(told["time_h"], dtype=NUMBER, name="time_h")
    if arrays["mean"].ndim == 1:
        frame = pandas.DataFrame(arrays, index=index)
    else:
        columns = pandas.MultiIndex.from_product([list(arrays), AXES], names=("of", "component"))
        frame = pandas.DataFrame(np.hstack(list(arrays.values())), index=index, columns=columns)
    frame.attrs = {name: value for name, value in told.items() if name not in LISTS}
    return frame


def blades(answer: Answer) -> DataFrame:
    """A row for each blade, by its name: facts, readings, and its prediction at one hour [unit].

    mean, sd     sd of a reading, in total; `sd_blade`: of the blade itself, without a reading's
                 noise; sd_<source>; of a vector mean_x, mean_y, …
    counting, overruled     how many of its readings count, and do not
    held_from_h             from when on it has too little of an adopted effect, where it has one
    known_<input>           its known inputs, where it has any
    """
    told: Any = answer
    rows = [_blade(item) for item in told["items"]]
    names = dict.fromkeys(name for row in rows for name in row)
    vector = any("mean_x" in row for row in rows)
    kinds = {n: k for n, k in BLADES.items() if not (vector and n in ("mean", "sd"))}
    kinds |= {n: NUMBER for n in names if n.startswith(("mean_", "sd_", "known_"))}
    frame = framed(rows, kinds).set_index("blade")
    frame.attrs = {name: value for name, value in told.items() if name not in ("items", "next")}
    return frame


def _blade(item: Any) -> dict[str, Any]:
    last, sd = item["readings"]["last"] or {}, dict(item["prediction"]["sd"])
    found = {name: item[name] for name in item if name in BLADES} | {"blade": item["id"]}
    found |= {name: item["readings"][name] for name in ("counting", "overruled")}
    found |= {f"last_{name}": value for name, value in last.items()}
    found["held_from_h"] = item["prediction"]["held_from_h"]
    found |= _of("mean", item["prediction"]["mean"]) | _of("sd", sd.pop("total"))
    for source, value in sd.items():
        found |= _of(f"sd_{source}", value)
    return found | {f"known_{name}": value for name, value in (item["known"] or {}).items()}


def _of(name: str, value: float | Sequence[float]) -> dict[str, float]:
    """A number by its name, or those of a vector by name and axis."""
    if isinstance(value, Sequence):
        return {f"{name}_{axis}": part for axis, part in zip(AXES, value, strict=True)}
    return {name: value}


def residuals(answer: Answer) -> DataFrame:
    """A row for each reading (and component) that was predicted before it was used.

    z   (y - mean) / sd, of unit variance where the model is adequate; pit: its probability
    """
    told: Any = answer
    frame = framed(told["items"], RESIDUALS)
    frame.attrs = {name: value for name, value in told.items() if name not in ("items", "next")}
    return frame


def draws(netcdf: bytes, *, joint: bool) -> DataFrame:
    """A column for each parameter; rows by draw, of joint draws by (draw, blade).

    Joint: all blades of a draw have the same shared parameters. ``attrs["units"]`` are those of
    the parameters, ``attrs["level"]`` tells which are shared.
    """
    import xarray

    with xarray.open_dataset(io.BytesIO(netcdf), group="posterior", engine="h5netcdf") as opened:
        found = opened.isel(chain=0, drop=True).load()
    level = {str(name): str(values.attrs["level"]) for name, values in found.data_vars.items()}
    names = sorted(level, key=lambda name: level[name] != "shared")
    if joint:
        frame = found.to_dataframe(dim_order=["draw", "blade"])[names]
    else:
        frame = found.isel(blade=0, drop=True).to_dataframe()[names]
    facts = {name: _plain(value) for name, value in found.attrs.items()}
    rests = {"sealed": facts["sealed"] == "true", "untold": json.loads(facts.get("untold", "[]"))}
    frame.attrs = {
        "rotor": facts["rotor"],
        "units": {name: str(found[name].attrs["units"]) for name in names},
        "level": {name: level[name] for name in names},
        "particles": facts["particles"],
        "health": json.loads(facts["health"]),
        "rests_on": {n: facts[n] for n in FACTS} | rests,
    }
    return frame


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value


def field(answer: Mapping[str, Any]) -> Dataset:
    """`mean` and `sd` [unit] over time_h, node and, of a vector, axis.

    answer   of `field_series`: arrays (T, N) or (T, N, 3), unit and facts

    Attributes are texts and numbers, so that ``to_netcdf`` takes them.
    """
    import xarray

    dims = ("time_h", "node", "axis")[: answer["mean"].ndim]
    coords: dict[str, Any] = {
        "time_h": ("time_h", answer["time_h"], {"units": "h", "long_name": "operating hours"}),
        "node": np.arange(answer["mean"].shape[1]),
    }
    coords |= {"axis": list(AXES)} if len(dims) == 3 else {}
    quantity, units = answer["facts"]["quantity"], {"units": answer["unit"]}
    return xarray.Dataset(
        {
            name: (dims, answer[name], units | {"long_name": f"{quantity}, {what}"})
            for name, what in (("mean", "mean"), ("sd", "standard deviation"))
        },
        coords=coords,
        attrs=answer["facts"] | units,
    )
