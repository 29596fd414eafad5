"""The client's types: made from the schemas, complete, and the same for both clients."""

from __future__ import annotations

import inspect
import re
from collections.abc import AsyncIterator, Coroutine, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, assert_type, get_type_hints

from service.api.answers import ANSWERS
from service.client import answers, beliefs, diagnoses, models, readings, rotors, webhooks
from service.client.steps import call, pages
from service.client.table import Calls
from tests.make_answer_types import FILE, NAMES, OF_ROUTES, item_of, text

MODULES = (beliefs, diagnoses, models, readings, rotors, webhooks)

if TYPE_CHECKING:
    from service.client import AsyncClient, Client

    def typed(twin: Client, other: AsyncClient) -> None:
        assert_type(twin.prediction("r", "b"), answers.Prediction)
        assert_type(twin.prediction("r", "b")["rests_on"]["version"], int)
        assert_type(twin.inspections("r"), Iterator[answers.Inspection])
        assert_type(other.inspections("r"), AsyncIterator[answers.Inspection])
        assert_type(other.rotor("r"), Coroutine[Any, Any, answers.Rotor])
        assert_type(twin.rotor("r")["posterior"], answers.Version | None)


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
    # of a blade or of a rotor, of many steps, or read from a file
    assert plain == ["upload_model", "draws", "field_series"]


def test_every_answer_that_the_client_asks_for_is_named() -> None:
    sources = "".join(Path(inspect.getfile(module)).read_text() for module in MODULES)
    used = set(re.findall(r"answers\.(\w+)", sources))
    assert used <= set(vars(answers))
    assert {"Prediction", "Rotor", "Inspection", "Diagnosis", "Residuals"} <= used
