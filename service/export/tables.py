"""A prediction as CSV: a row for each hour, and for a vector for each of x, y and z."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from typing import Any

Json = dict[str, Any]
OF_ALL = ("rotor", "version", "blade", "quantity", "unit", "node", "instrument")
AXES = ("x", "y", "z")


def prediction_csv(told: Json) -> bytes:
    """The answer of ``GET …/prediction`` as CSV; numbers are the same to the last digit.

    >>> one = {"rotor": "r1", "blade": "B1", "quantity": "elongation", "unit": "mm", "node": None}
    >>> one |= {"instrument": None, "probability": 0.95, "time_h": [8000.0], "mean": [0.125]}
    >>> one |= {"sd": {"total": [0.5]}, "lower": [-1.0], "upper": [1.0], "quantiles": {}}
    >>> one |= {"held_from_h": None}
    >>> rests = {"version": 3, "sealed": True}
    >>> print(prediction_csv(one | {"rests_on": rests, "health": {"trusted": True}}).decode())
    rotor,version,blade,quantity,unit,node,instrument,component,sealed,trusted,time_h,\
probability,mean,sd_total,lower,upper,held
    r1,3,B1,elongation,mm,,,,true,true,8000.0,0.95,0.125,0.5,-1.0,1.0,false
    <BLANKLINE>
    """
    parts = {
        "mean": told["mean"],
        **{f"sd_{name}": values for name, values in told["sd"].items()},
        "lower": told["lower"],
        "upper": told["upper"],
        **{f"q{level}": values for level, values in told["quantiles"].items()},
    }
    whole = told | {"version": told["rests_on"]["version"]}
    state = [str(told["rests_on"]["sealed"]).lower(), str(told["health"]["trusted"]).lower()]
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    more = ("component", "sealed", "trusted", "time_h", "probability")
    writer.writerow([*OF_ALL, *more, *parts, "held"])
    for i, hour in enumerate(told["time_h"]):
        held = str(told["held_from_h"] is not None and hour >= told["held_from_h"]).lower()
        for axis, numbers in _rows([values[i] for values in parts.values()]):
            head = [whole[name] for name in OF_ALL]
            writer.writerow([*head, axis, *state, hour, told["probability"], *numbers, held])
    return out.getvalue().encode()


def _rows(values: list[Any]) -> Iterator[tuple[str, list[float]]]:
    if not isinstance(values[0], list):
        yield "", values
        return
    for j, axis in enumerate(AXES):
        yield axis, [value[j] for value in values]
