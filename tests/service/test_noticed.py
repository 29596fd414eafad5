"""What an `adequate` is worth is told: in the report, by the command, on the page's document."""

from __future__ import annotations

import copy

import pytest

from core.diagnosis.noticed import NOTHING
from service.diagnose_command import lines_of
from service.report.page import report
from service.report.verdict import do_next
from tests.service.told import Json, told


def page_of(found: Json) -> str:
    return report(found, "r1", "d1", "2031-05-04T10:00:00.000Z")


def blind() -> Json:
    found = told("adequate")
    for one in found["noticed"]["families"]:
        one["least"] = one["most"] = None
    return found


def test_the_sizes_that_would_have_alarmed_stand_in_the_report_in_engineers_units() -> None:
    page = page_of(told("adequate"))
    assert "What would have been noticed" in page
    for shown in (
        "coating wear, a coating lot", "6.1 % (C2, early)", "12 % (C1, late)",
        "7.5 K (at 8,000 h)", "campaign offset, a campaign", "0.012 mm", "90% probability",
    ):  # fmt: skip
        assert shown in page, shown
    assert "forecasts and bands of the model can be used" in page


def test_the_command_tells_them_too() -> None:
    said = list(lines_of({"rotor": "r1", "result": told("adequate")}))
    first = said.index("an alarm would have been raised, with 90% probability, by")
    assert said[first + 1].split("  ")[-1].strip() == "6.1 % (C2, early) … 12 % (C1, late)"
    assert said[first + 2].endswith("7.5 K (at 8,000 h) … –")
    assert said[first + 3].endswith(" 0.012 mm")


def test_a_comparison_says_what_is_in_the_model_after() -> None:
    """Where nothing is claimed it is a discrepancy without a cause."""
    for claimed in (True, False):
        found = told("effect", claimed=claimed)
        said = list(lines_of({"rotor": "r1", "result": found}))
        (line,) = (one for one in said if "before → after" in one)
        assert line.endswith("(with a discrepancy that names no cause)") != claimed


def test_readings_that_could_not_contradict_the_model_are_nothing_to_rest_on() -> None:
    assert do_next(blind()).startswith("Do not rest anything on this")
    assert "forecasts and bands of the model can be used" not in page_of(blind())
    assert "too few" in NOTHING
    said = list(lines_of({"rotor": "r1", "result": blind()}))
    assert not any("alarm would have been raised" in line for line in said)


@pytest.mark.parametrize("verdict", ["effect", "not separable", "unattributed"])
def test_where_something_was_found_nothing_is_said_of_it(verdict: str) -> None:
    assert "What would have been noticed" not in page_of(told(verdict))


def test_an_older_result_says_nothing_of_it() -> None:
    found = copy.deepcopy(told("adequate"))
    del found["noticed"]
    assert "What would have been noticed" not in page_of(found)
    assert "forecasts and bands of the model can be used" in page_of(found)
