"""Which scope each route asks of a key. What is not in this table is not served.

The gate looks a request up here before the router sees it, so that a route that somebody forgot
to enter answers 404 in its first test instead of being open to everybody.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from starlette.routing import compile_path

from service.access import Scope

STATE_CHANGING = frozenset({"POST", "PUT", "PATCH", "DELETE"})


@dataclass(frozen=True, slots=True)
class Rule:
    """What a route asks for.

    scope    ``open``: nobody needs a key for it
    beyond   a key for some rotors may use it though it names no rotor: it tells of none, or of
             the key's own alone
    """

    scope: Scope | Literal["open"]
    beyond: bool = False


ROTOR = "/v1/rotors/{r}"
RULES: dict[str, Rule] = {
    "GET /healthz": Rule("open"),
    "GET /readyz": Rule("open"),
    "GET /": Rule("open"),
    "GET /assets/{name:path}": Rule("open"),
    "GET /models": Rule("open"),
    "GET /models/{m}": Rule("open"),
    "GET /operations": Rule("open"),
    "GET /rotors/{r}": Rule("open"),
    "GET /rotors/{r}/readings": Rule("open"),
    "GET /rotors/{r}/blades/{b}": Rule("open"),
    "GET /rotors/{r}/blades/{b}/3d": Rule("open"),
    "GET /rotors/{r}/residuals": Rule("open"),
    "GET /rotors/{r}/diagnoses": Rule("open"),
    "GET /rotors/{r}/diagnoses/{d}": Rule("open"),
    "GET /metrics": Rule("read"),
    "GET /openapi.json": Rule("read", beyond=True),
    "GET /v1/models": Rule("read", beyond=True),
    "GET /v1/models/{m}": Rule("read", beyond=True),
    "GET /v1/models/{m}/surface": Rule("read", beyond=True),
    "POST /v1/models": Rule("operate"),
    "GET /v1/jobs/{id}": Rule("read", beyond=True),
    "GET /v1/rotors": Rule("read", beyond=True),
    "POST /v1/rotors": Rule("operate"),
    f"GET {ROTOR}": Rule("read"),
    f"POST {ROTOR}/retry": Rule("operate"),
    f"POST {ROTOR}/policy": Rule("operate"),
    f"POST {ROTOR}/blades": Rule("operate"),
    f"POST {ROTOR}/blades/{{b}}/retirement": Rule("operate"),
    f"GET {ROTOR}/inspections": Rule("read"),
    f"POST {ROTOR}/inspections": Rule("ingest"),
    f"GET {ROTOR}/inspections/{{i}}": Rule("read"),
    f"POST {ROTOR}/inspections/{{i}}/retraction": Rule("ingest"),
    f"GET {ROTOR}/posterior": Rule("read"),
    f"GET {ROTOR}/blades/{{b}}/posterior": Rule("read"),
    f"GET {ROTOR}/blades/{{b}}/prediction": Rule("read"),
    f"GET {ROTOR}/blades/{{b}}/life": Rule("read"),
    f"GET {ROTOR}/life": Rule("read"),
    f"GET {ROTOR}/series": Rule("read"),
    f"GET {ROTOR}/plan": Rule("read"),
    f"GET {ROTOR}/blades": Rule("read"),
    f"GET {ROTOR}/draws": Rule("read"),
    f"GET {ROTOR}/field": Rule("read"),
    f"GET {ROTOR}/blades/{{b}}/draws": Rule("read"),
    f"GET {ROTOR}/blades/{{b}}/field": Rule("read"),
    f"GET {ROTOR}/versions": Rule("read"),
    f"GET {ROTOR}/events": Rule("read"),
    f"GET {ROTOR}/diagnoses": Rule("read"),
    f"POST {ROTOR}/diagnoses": Rule("operate"),
    f"GET {ROTOR}/diagnoses/{{d}}": Rule("read"),
    f"GET {ROTOR}/diagnoses/{{d}}/report": Rule("read"),
    f"DELETE {ROTOR}/diagnoses/{{d}}": Rule("operate"),
    f"POST {ROTOR}/diagnoses/{{d}}/adoption": Rule("operate"),
    f"DELETE {ROTOR}/diagnoses/{{d}}/adoption": Rule("operate"),
    f"GET {ROTOR}/adoptions": Rule("read"),
    "GET /v1/webhooks": Rule("operate"),
    "POST /v1/webhooks": Rule("operate"),
    "GET /v1/webhooks/{w}": Rule("operate"),
    "DELETE /v1/webhooks/{w}": Rule("operate"),
    "GET /v1/webhooks/{w}/deliveries": Rule("operate"),
    "POST /v1/webhooks/{w}/deliveries/{d}/retry": Rule("operate"),
    f"GET {ROTOR}/residuals": Rule("read"),
    "GET /v1/audit": Rule("operate", beyond=True),
    "GET /v1/operations": Rule("read"),
}


@dataclass(frozen=True, slots=True)
class Found:
    """Where a request leads; `rotor` as the path names it."""

    name: str
    rule: Rule
    rotor: str | None


class Table:
    """Finds the rule of a request.

    >>> Table(RULES).find("GET", "/v1/rotors/r7/posterior").rotor
    'r7'
    >>> Table(RULES).find("PATCH", "/v1/rotors")
    ['GET', 'HEAD', 'POST']
    >>> Table(RULES).find("GET", "/v1/engines")
    []
    """

    def __init__(self, rules: dict[str, Rule]) -> None:
        by_path: dict[str, dict[str, Rule]] = {}
        for name, rule in rules.items():
            method, path = name.split(" ")
            by_path.setdefault(path, {})[method] = rule
        self._paths = [(compile_path(path)[0], path, by_path[path]) for path in by_path]

    def find(self, method: str, path: str) -> Found | list[str]:
        """The rule, or the methods that the path has: none where there is no such path. HEAD is
        asked for as GET (`service.api.heads`)."""
        for pattern, template, rules in self._paths:
            match = pattern.match(path)
            if match is None:
                continue
            if method not in rules:
                return sorted({*rules, *(("HEAD",) if "GET" in rules else ())})
            return Found(f"{method} {template}", rules[method], match.groupdict().get("r"))
        return []
