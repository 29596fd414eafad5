"""The plan with two undeclared effects: what is planted, and that nothing else is."""

from __future__ import annotations

import numpy as np

from core.builtin import inspection_plan, worn_plan
from core.builtin.inspection_plan import blades

CLEAN, WORN = inspection_plan.load(), worn_plan.load()


def by_id(plan: inspection_plan.Plan) -> dict[str, dict[str, object]]:
    return {str(body["id"]): body for body in plan.inspections}


def test_only_elongations_of_the_lot_and_of_the_campaign_differ() -> None:
    clean, worn = by_id(CLEAN), by_id(WORN)
    assert clean.keys() == worn.keys()
    moved = {i for i in clean if clean[i] != worn[i]}
    assert moved == {
        i
        for i, body in clean.items()
        if body["quantity"] == "elongation"
        and (
            worn_plan.coating_lot(str(body["blade"])) == "C2"
            or body["campaign"] == worn_plan.CAMPAIGN
        )
    }
    assert all({**clean[i], "value": 0} == {**worn[i], "value": 0} for i in moved)


def test_the_campaign_reads_too_long_by_what_is_said_and_the_worn_lot_by_its_wear() -> None:
    clean, worn = by_id(CLEAN), by_id(WORN)
    names = list(blades())
    for i, body in clean.items():
        if body["quantity"] != "elongation":
            continue
        number = names.index(str(body["blade"]))
        hour = float(str(body["time_h"]))
        wear = WORN.elongation[number] - CLEAN.elongation[number]
        expected = float(np.interp(hour, WORN.time_h, wear))
        expected += worn_plan.OFFSET if body["campaign"] == worn_plan.CAMPAIGN else 0.0
        moved = float(str(worn[i]["value"])) - float(str(body["value"]))
        assert abs(moved - expected) < 6e-5, i


def test_blades_of_the_lot_wear_and_no_others() -> None:
    lot = np.array([worn_plan.coating_lot(b) == "C2" for b in blades()])
    assert tuple(np.flatnonzero(lot)) == worn_plan.WORN
    assert np.array_equal(CLEAN.elongation[~lot], WORN.elongation[~lot])
    late = WORN.time_h >= 8000.0
    grown = (WORN.elongation / np.where(CLEAN.elongation > 0, CLEAN.elongation, 1.0))[lot][:, late]
    assert np.all(grown > 1.0)
    assert np.all(np.diff(grown, axis=1) > 0), "wear adds ever more"


def test_a_blades_own_course_loses_the_share_that_is_said() -> None:
    points = worn_plan.course({"tbc_thickness": 1.2, "t1t_rate": 0.9})["tbc_thickness"]
    assert points[0] == (0.0, 1.2)
    assert points[-1] == (worn_plan.LOST_BY_H, (1 - worn_plan.LOST) * 1.2)
