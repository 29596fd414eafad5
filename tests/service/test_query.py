"""No query parameter is passed over: what a route does not know is refused by name."""

from __future__ import annotations

import httpx
import pytest

NAMES = {"r": "r1", "b": "B1", "i": "i1", "m": "rotor-blade", "id": "j1", "d": "d1", "w": "w1"}
BANDS = "/v1/rotors/r1/blades/B1/prediction"


@pytest.fixture
def database_url(sqlite_url: str) -> str:
    """What is refused never comes to the database."""
    return sqlite_url


def test_every_route_refuses_a_parameter_that_it_does_not_know(
    api: httpx.Client, rotor: str
) -> None:
    told = api.get("/openapi.json").json()["paths"]
    asked = 0
    for path, operations in told.items():
        if not path.startswith("/v1/"):
            continue
        for method in operations:
            url = path.format(**NAMES)
            body = {"json": {}} if method == "post" else {}
            answer = api.request(method.upper(), url, params={"no_such": "1"}, **body)
            assert answer.status_code == 422, (method, path)
            (fault,) = answer.json()["faults"]
            assert fault["field"] == "no_such", (method, path)
            assert (fault["value"], fault["problem"]) == ("1", "is no parameter of this route")
            asked += 1
    assert asked > 35


@pytest.mark.parametrize(
    ("query", "field", "problem", "remedy"),
    [
        ("probabilty=0.5", "probabilty", "is no parameter of this route", "use probability"),
        ("time=8000", "time", "is no parameter of this route", "use times"),
        ("times=1&times=2", "times", "is given more than once", "give it once"),
    ],
)
def test_the_parameter_that_was_meant_is_named(
    api: httpx.Client, rotor: str, query: str, field: str, problem: str, remedy: str
) -> None:
    answer = api.get(f"{BANDS}?{query}")
    assert answer.status_code == 422
    (fault,) = answer.json()["faults"]
    assert (fault["field"], fault["problem"], fault["remedy"]) == (field, problem, remedy)


def test_each_of_several_is_told(api: httpx.Client, rotor: str) -> None:
    faults = api.get(f"{BANDS}?a=1&times=8000&b=2").json()["faults"]
    assert [one["field"] for one in faults] == ["a", "b"]


def test_nothing_is_done_of_a_request_with_one(api: httpx.Client, rotor: str) -> None:
    body = {"id": "i1", "blade": "B1", "quantity": "elongation", "time_h": 8000.0, "value": 0.11}
    path = "/v1/rotors/r1/inspections"
    assert api.post(path, params={"dry_run": "true"}, json=body).status_code == 422
    assert api.get(path).json()["items"] == []


def test_probes_may_have_what_they_like(api: httpx.Client) -> None:
    assert api.get("/healthz?t=1").status_code == 200


def test_no_route_takes_the_second_of_a_field_that_is_given_twice(
    api: httpx.Client, rotor: str
) -> None:
    """JSON's readers take the last without a word: of each route that takes a body."""
    told = api.get("/openapi.json").json()["paths"]
    sent, asked = {"Content-Type": "application/json"}, 0
    for path, operations in told.items():
        if "requestBody" not in operations.get("post", {}):
            continue
        body = b'{"id": "x", "deep": [{"a": 1, "b": 2, "a": 3}], "id": "y"}'
        answer = api.post(path.format(**NAMES), content=body, headers=sent)
        assert answer.status_code == 422, path
        faults = [(one["field"], one["value"], one["remedy"]) for one in answer.json()["faults"]]
        twice = [("a", "[1, 3]", "give it once"), ("id", "['x', 'y']", "give it once")]
        assert faults == twice, path
        asked += 1
    assert asked > 8
    assert [one["id"] for one in api.get("/v1/rotors").json()["items"]] == [rotor], "none was made"
