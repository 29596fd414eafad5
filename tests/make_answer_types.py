"""Makes the types of the client's answers from the schemas of the OpenAPI document.

    python -m tests.make_answer_types

writes ``service/client/answers.py``: a TypedDict for each object of `service.api.answers`, so that
editors and type checkers know what comes, while an answer stays the plain dict that it is. A test
holds file and schemas together, and another one (`tests/service/test_contract.py`) the schemas and
what the service answers.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

from service.api import answers
from service.api.answers import beliefs, diagnoses, others, residuals, shown

Json = dict[str, Any]
FILE = Path(__file__).parents[1] / "service" / "client" / "answers.py"
ROTOR = answers.ROTOR
HEAD = '''"""What the service answers, for type checkers: plain dicts at run time.

Made from the schemas of the OpenAPI document by ``python -m tests.make_answer_types``; a test holds
both together. Moments are texts of ISO 8601, hours operating hours, `rests_on` what an answer
follows from.
"""

from __future__ import annotations

from typing import Any, Literal, NotRequired, TypedDict
'''
NAMES: tuple[tuple[str, Json], ...] = (
    ("Health", beliefs.HEALTH),
    ("RestsOn", beliefs.RESTS_ON),
    ("Blade", beliefs.BLADE),
    ("Version", beliefs.POSTERIOR_OF_ROTOR),
    ("Inspection", beliefs.INSPECTION),
    ("Accepted", beliefs.ACCEPTED),
    ("Job", beliefs.JOB),
    ("Prediction", beliefs.PREDICTION),
    ("Life", beliefs.LIFE),
    ("RotorLife", beliefs.ROTOR_LIFE),
    ("SeriesRow", beliefs.SERIES["properties"]["items"]["items"]),
    ("Parameter", beliefs.SUMMARY["parameters"]["additionalProperties"]),
    ("Model", others.MODEL),
    ("Surface", others.SURFACE),
    ("BladeAtOneHour", others.BLADE_AT_A_GLANCE),
    ("Draws", others.DRAWS),
    ("RotorDraws", others.ROTOR_DRAWS),
    ("Field", others.FIELD),
    ("Webhook", others.WEBHOOK),
    ("Delivery", others.DELIVERY),
    ("Residual", residuals.RESIDUAL),
    ("ResidualTest", residuals.TEST),
    ("Visit", residuals.VISIT),
    ("Residuals", residuals.RESIDUALS),
    ("Planned", shown.PLANNED),
    ("Adoption", diagnoses.ADOPTION),
    ("Course", shown.COURSE),
    ("Foreseen", shown.TWICE),
    ("Placed", shown.PLACED),
    ("Pictures", shown.PICTURES),
    ("Separating", shown.SEPARATING),
    ("Found", diagnoses.FOUND),
    ("Diagnosis", diagnoses.DIAGNOSIS),
)
OF_ROUTES = {
    "GET /v1/models": "ModelListed",
    "GET /v1/rotors": "RotorListed",
    "POST /v1/rotors": "RotorMade",
    f"GET {ROTOR}": "Rotor",
    f"POST {ROTOR}/retry": "Standing",
    f"GET {ROTOR}/versions": "KeptVersion",
    f"GET {ROTOR}/posterior": "RotorPosterior",
    f"GET {ROTOR}/blades/{{b}}/posterior": "BladePosterior",
    f"GET {ROTOR}/plan": "Plan",
    f"GET {ROTOR}/diagnoses": "DiagnosisListed",
    f"POST {ROTOR}/diagnoses/{{d}}/adoption": "Adopted",
    f"DELETE {ROTOR}/diagnoses/{{d}}/adoption": "BackedOut",
    "POST /v1/webhooks": "WebhookMade",
    "DELETE /v1/webhooks/{w}": "WebhookDeleted",
}
PLAIN = {"string": "str", "integer": "int", "number": "float", "boolean": "bool", "null": "None"}


class Classes:
    """The classes made so far, in an order in which each follows those that it names."""

    def __init__(self) -> None:
        self.made: list[tuple[str, Json]] = []
        self.texts: list[str] = []

    def of(self, schema: Json, name: str) -> str:
        """The type of a schema as Python writes it; `name`: of a class that has none yet."""
        if "anyOf" in schema:
            return "Any"  # a number of a scalar, or a list of numbers of a vector
        if "enum" in schema:
            said = [repr(one) for one in schema["enum"] if one is not None]
            none = " | None" if None in schema["enum"] else ""
            return f"Literal[{', '.join(said)}]{none}".replace("'", '"')
        kinds = schema.get("type")
        if isinstance(kinds, list):
            one = self.of(schema | {"type": kinds[0]}, name)
            return f"{one} | None" if "null" in kinds else one
        if kinds == "array":
            return f"list[{self.of(schema['items'], singular(name))}]"
        if kinds == "object":
            return self._object(schema, name)
        return PLAIN.get(str(kinds), "Any")

    def _object(self, schema: Json, name: str) -> str:
        if "properties" not in schema:
            more = schema.get("additionalProperties")
            value = self.of(more, singular(name)) if isinstance(more, dict) else "Any"
            return f"dict[str, {value}]"
        for known, same in self.made:
            if all(same[part] == schema[part] for part in ("properties", "required")):
                return known
        assert name not in dict(self.made), f"{name} is the name of two objects"
        lines = [f"class {name}(TypedDict):"]
        for field, told in schema["properties"].items():
            kind = self.of(told, name + camel(field))
            needed = field in schema["required"]
            lines.append(f"    {field}: {kind if needed else f'NotRequired[{kind}]'}")
        self.made.append((name, schema))
        self.texts.append("\n".join(lines))
        return name


def camel(field: str) -> str:
    return "".join(word.capitalize() for word in field.split("_"))


def singular(name: str) -> str:
    """The name of one of many.

    >>> singular("FoundConditions"), singular("Readings"), singular("FoundHolds")
    ('FoundCondition', 'Reading', 'FoundHold')
    """
    return name[:-1] if name.endswith("s") else name


def item_of(schema: Json) -> Json:
    """What a page lists; the schema itself where it is none."""
    properties = schema.get("properties", {})
    listed: Json = properties["items"]["items"] if set(properties) == {"items", "next"} else schema
    return listed


def text() -> str:
    """The module, as it is formatted."""
    classes = Classes()
    for name, schema in NAMES:
        classes.of(schema, name)
    for route, name in OF_ROUTES.items():
        classes.of(item_of(answers.ANSWERS[route]), name)
    whole = "\n\n\n".join([HEAD, *classes.texts]) + "\n"
    ruff = [str(Path(sys.executable).with_name("ruff")), "format", "--stdin-filename", str(FILE)]
    done = subprocess.run([*ruff, "-"], input=whole, capture_output=True, text=True, check=True)
    return done.stdout


if __name__ == "__main__":
    FILE.write_text(text())
