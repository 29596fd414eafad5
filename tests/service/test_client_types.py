"""The client's types: made from the schemas, complete, and the same for both clients."""

from __future__ import annotations

import inspect
import re
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, assert_type, get_args, get_type_hints, is_typeddict

from service.api.answers import ANSWERS
from service.client import answers, beliefs, diagnoses, models, readings, rotors, webhooks
from service.client.steps import Call, Walk, call, pages
from service.client.table import Calls
from tests.make_answer_types import FILE, NAMES, OF_ROUTES, Classes, item_of, text

Json = dict[str, Any]
GIVEN: Json = {"blades": ["b"], "inspections": [], "limit": 0.9, "seq": 1, "network": ""}
IN_A_FIELD = {"models": "items", "diagnose": "diagnosis", "upload_model": "job"}
ENDS_WITH = {"register": "GET /v1/models/{m}"}
MODULES = (beliefs, diagnoses, models, readings, rotors, webhooks)

if TYPE_CHECKING:
    from service.client import AsyncClient, Client

    async def typed(twin: Client, other: AsyncClient) -> None:
        assert_type(twin.prediction("r", "b"), answers.Prediction)
        assert_type(twin.prediction("r", "b")["rests_on"]["version"], int)
        assert_type(twin.inspections("r"), Iterator[answers.Inspection])
        assert_type(other.inspections("r"), AsyncIterator[answers.Inspection])
        assert_type(await other.rotor("r"), answers.Rotor)
        assert_type(twin.rotor("r")["posterior"], answers.Version | None)
        twin.prediction("r", "b")["men"]  # type: ignore[misc]  # a negative control


def test_the_file_is_what_the_schemas_make() -> None:
    assert FILE.read_text() == text(), "run `python -m tests.make_answer_types`"


def test_every_name_is_of_its_schema_field_by_field() -> None:
    named = {**dict(NAMES), **{name: item_of(ANSWERS[r]) for r, name in OF_ROUTES.items()}}
    for name, schema in named.items():
        made = getattr(answers, name)
        assert list(made.__annotations__) == list(schema["properties"]), name
        hints = get_type_hints(made, include_extras=True)
        lacking = {field for field, kind in hints.items() if "NotRequired" in str(kind)}
        assert lacking == set(schema["properties"]) - set(schema["required"]), name


def test_every_call_that_is_answered_with_json_has_a_type() -> None:
    plain = []
    for name, method in vars(Calls).items():
        if isinstance(method, pages):
            if method.through == "_pages":
                assert method.of.__module__ == "service.client.answers", name
        elif isinstance(method, call) and "Json" in method.steps.__annotations__["return"]:
            plain.append(name)
    # of a blade or of a rotor; read from a file
    assert plain == ["draws", "field_series"]


def first_of(name: str, steps: Any, file: Path) -> Call:
    """The first request of a call, made with anything."""
    given = GIVEN | {"runs": file}
    needed = {
        n: given.get(n, "x") for n, p in inspect.signature(steps).parameters.items()
        if p.default is p.empty and p.kind is not p.VAR_KEYWORD
    }  # fmt: skip
    found = steps(**needed)
    asked = found if isinstance(found, Call) else Walk(found).go()
    assert isinstance(asked, Call), name
    return asked


def route_of(asked: Call) -> str:
    for route in ANSWERS:
        method, where = route.split(" ")
        pattern = re.sub(r"\{\w+\}", "[^/]+", where)
        if method == asked.method and re.fullmatch(pattern, asked.path):
            return route
    raise AssertionError(f"{asked.method} {asked.path} has no schema")


def test_every_call_says_the_type_of_the_route_that_it_asks(tmp_path: Path) -> None:
    classes = Classes()
    for known, schema in NAMES:
        classes.of(schema, known)
    for route, known in OF_ROUTES.items():
        classes.of(item_of(ANSWERS[route]), known)
    (file := tmp_path / "runs.nc").touch()
    seen = set()
    steps: Any
    for name, method in vars(Calls).items():
        if isinstance(method, pages):
            steps, said = method.first, method.of
        elif isinstance(method, call) and method.steps.__module__ != "service.client.frames":
            steps, said = method.steps, get_args(get_type_hints(method.steps)["return"])[-1]
            said = get_args(said)[0] if name == "models" else said
        else:
            continue
        if not is_typeddict(said):
            continue
        schema = ANSWERS[ENDS_WITH.get(name) or route_of(first_of(name, steps, file))]
        properties = schema["properties"]
        if isinstance(method, pages) or IN_A_FIELD.get(name) == "items":
            schema = properties["items"]["items"]
        elif name in IN_A_FIELD:
            schema = properties[IN_A_FIELD[name]]
        assert said.__name__ == classes.of(schema, f"unnamed_{name}"), name
        seen.add(name)
    assert len(seen) > 30


def test_every_answer_that_the_client_asks_for_is_named() -> None:
    sources = "".join(Path(inspect.getfile(module)).read_text() for module in MODULES)
    used = set(re.findall(r"answers\.(\w+)", sources))
    assert used <= set(vars(answers))
    assert {"Prediction", "Rotor", "Inspection", "Diagnosis", "Residuals"} <= used
