"""A field that nobody knows is refused with the names that there are."""

from __future__ import annotations

from typing import Any

import httpx
import pytest

from service.ports import Json


@pytest.fixture
def database_url(sqlite_url: str) -> str:
    """What is refused never comes to the database."""
    return sqlite_url


def properties(document: Json, schema: Json) -> list[str]:
    """Of a body of the document, in its order; none: it may be of several kinds."""
    whole = schema.get("anyOf", [schema])[0]  # the body, where it may be left out
    if "$ref" in whole:
        whole = document["components"]["schemas"][whole["$ref"].rpartition("/")[2]]
    return list(whole.get("properties", ()))


def test_every_route_with_a_body_tells_the_names_that_its_fields_have(
    api: httpx.Client, rotor: str
) -> None:
    document = api.get("/openapi.json").json()
    seen = []
    for path, methods in document["paths"].items():
        for method, told in methods.items():
            content = told.get("requestBody", {}).get("content", {})
            names = properties(document, content.get("application/json", {}).get("schema", {}))
            if not names or path == "/v1/rotors/{r}/inspections":
                continue
            url = path.replace("{r}", rotor).replace("{d}", "d1").replace("{i}", "i1")
            sent = api.request(method.upper(), url, json={"no_such_field": 1})
            assert sent.status_code == 422, (method, path, sent.text)
            (fault,) = (f for f in sent.json()["faults"] if f["field"] == "no_such_field")
            assert fault["remedy"].endswith(f"it is one of {', '.join(names)}"), (path, fault)
            seen.append(path)
    assert {"/v1/models", "/v1/rotors", "/v1/rotors/{r}/diagnoses/{d}/adoption"} <= set(seen)
    assert len(seen) > 5


@pytest.mark.parametrize(
    ("path", "body", "field", "meant"),
    [
        ("/v1/rotors", {"blades": [{"id": "B1", "lots": "L1"}]}, "blades[0].lots", "lot"),
        ("/v1/rotors/r1/blades", {"id": "B9", "cotaing_lot": "x"}, "cotaing_lot", "coating_lot"),
        ("/v1/rotors/r1/diagnoses", {"familys": []}, "familys", "families"),
        (
            "/v1/rotors/r1/diagnoses",
            {"families": [{"name": "n", "sizes": 1.0}]},
            "families[0].sizes",
            "size",
        ),
        (
            "/v1/rotors/r1/inspections",
            {"inspections": [{"id": "a", "time": 1.0}]},
            "inspections[0].time",
            "time_h",
        ),
        ("/v1/rotors/r1/inspections", {"id": "a", "hours": 1.0}, "hours", None),
    ],
)
def test_a_name_that_is_nearly_right_is_told_as_it_is_written(
    api: httpx.Client, rotor: str, path: str, body: Any, field: str, meant: str | None
) -> None:
    sent = api.post(path, json=body)
    assert sent.status_code == 422, sent.text
    (fault,) = (f for f in sent.json()["faults"] if f["field"] == field)
    assert (f"{meant!r} was meant?" in fault["remedy"]) is (meant is not None), fault
    assert "ne of " in fault["remedy"]
