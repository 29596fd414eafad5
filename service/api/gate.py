"""Who may pass: key, rate, schema (of what would change the database), scope, rotor, in this order,
before anything else looks at a request.

Without a usable key every path answers alike, whether it exists or not: the same 401 with the same
body. With one, what a key may not do is 403, and a rotor that it does not know is 404, whether it
exists or not. Why a key was not accepted stands in the log alone.

A token that this process has not met yet is looked up in the database while its address has tokens
left, and beyond that so often a second as `LOOKS` says for all addresses: whoever tries keys by the
thousand is told 429, as one without a key is, and a key that is new to this process gets through
beside them. Keys that were met pass by their own rate, from whatever address.
"""

from __future__ import annotations

import logging
import math
from collections import OrderedDict

from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Receive, Scope, Send

from service import telemetry
from service.access import LOOPBACK, Act, KeyRecord
from service.api.loopback import by_loopback, keys_required
from service.api.outdated import Outdated
from service.api.preconditions import guard_of
from service.api.problems import fault, problem
from service.api.rate import MOST_BUCKETS, Buckets, network
from service.api.refusals import away, missing
from service.api.scopes import RULES, STATE_CHANGING, Found, Table
from service.api.visit import Visit, visit_of
from service.errors import NotFoundError, StoreAwayError
from service.handlers.keys import recognise
from service.ports import Store
from service.settings import Settings
from service.tokens import digest

log = logging.getLogger("bladetwin.gate")
NEEDS_KEY = (
    "this service answers those who have a key. To mend it: send `Authorization: Bearer KEY`; "
    "`bladetwin keys create` on the server makes one."
)


LOOKS = 5.0  # a second, for keys from addresses without a token left


class Gate:
    """ASGI middleware: lets a request pass, or answers it."""

    def __init__(self, app: ASGIApp, store: Store, settings: Settings, outdated: Outdated) -> None:
        self.app = app
        self.store = store
        self.outdated = outdated
        self.always = keys_required(settings)
        self.origins = settings.origins
        self.buckets = Buckets(settings.rate(limited=self.always), settings.rate_burst)
        self.table = Table(RULES)
        self.looks = Buckets(LOOKS, math.ceil(LOOKS))
        self._met: OrderedDict[str, None] = OrderedDict()  # digests of tokens that were keys

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        visit = visit_of(scope)
        if scope["type"] != "http" or visit is None:
            if scope["type"] == "lifespan":
                await self.app(scope, receive, send)
            return
        found = self.table.find(scope["method"], scope["path"])
        if isinstance(found, Found) and found.rule.scope == "open":
            await self.app(scope, receive, send)
            return
        refused = await self._refusal(Request(scope), visit, found)
        await (refused or self.app)(scope, receive, send)

    async def _refusal(
        self, request: Request, visit: Visit, found: Found | list[str]
    ) -> JSONResponse | None:
        """The answer to a request that may not pass; None: it may."""
        given = Headers(scope=request.scope).getlist("authorization")
        address = f"address {network(visit.address)}"
        if given:
            met = digest(_token(given)) in self._met
            wait_s = 0.0 if met else self.buckets.wait_s(address)
            if wait_s and not self.looks.take("looks").allowed:
                return _slower(request, wait_s)
            try:
                visit.key = await self._key_of(given)
            except StoreAwayError as error:
                return away(request, error)
        known = visit.key is not None or not (
            given or self.always or not by_loopback(request.scope, self.origins)
        )
        who = f"key {visit.key.id}" if visit.key else address
        telemetry.tell(who=visit.key.id if visit.key else LOOPBACK if known else None)
        taken = self.buckets.take(who)
        visit.headers |= taken.headers
        if not taken.allowed:
            return _slower(request, taken.wait_s)
        if not known:
            return _stranger(request)
        if isinstance(found, list):
            return _nowhere(request, found)
        if request.method in STATE_CHANGING:  # before it has a row in the audit trail
            refused = await self.outdated.refusal(request)
            if refused is not None:
                return refused
        self._begin(request, visit, found)
        return None if visit.key is None else _beyond(request, visit.key, found)

    async def _key_of(self, given: list[str]) -> KeyRecord | None:
        scheme = given[0].partition(" ")[0]
        if len(given) > 1 or scheme.lower() != "bearer":
            log.warning("401: Authorization is not one Bearer key")
            return None
        token = _token(given)
        recognised = await run_in_threadpool(recognise, self.store, token)
        if recognised.key is None:
            log.warning("401: %s", recognised.reason)
            self._met.pop(digest(token), None)
            return None
        self._met[digest(token)] = None
        if len(self._met) > MOST_BUCKETS:
            self._met.popitem(last=False)
        return recognised.key

    @staticmethod
    def _begin(request: Request, visit: Visit, found: Found) -> None:
        """From here on a state-changing request has its row in the audit trail."""
        if request.method not in STATE_CHANGING:
            return
        key = visit.key
        visit.act = Act(
            key_id=key.id if key else None,
            who=key.name if key else LOOPBACK,
            address=visit.address,
            request_id=visit.request_id,
            what=found.name,
            path=request.url.path,
            rotor=found.rotor,
        )
        visit.guard = guard_of(request, found.rotor)


def _token(given: list[str]) -> str:
    """The token of an Authorization header."""
    return given[0].partition(" ")[2].strip()


def _stranger(request: Request) -> JSONResponse:
    """The one answer to all who have no usable key; it does not even repeat the path."""
    headers = {"WWW-Authenticate": 'Bearer realm="bladetwin"'}
    return problem(request, 401, "key-required", NEEDS_KEY, (), headers, instance="")


def _slower(request: Request, wait_s: float) -> JSONResponse:
    seconds = max(1, math.ceil(wait_s))
    remedy = f"try again in {seconds} s, and put readings into batches"
    detail = f"too many requests; nothing was done. To mend it: {remedy}."
    headers = {"Retry-After": str(seconds)}
    return problem(request, 429, "too-many-requests", detail, (), headers, instance="")


def _nowhere(request: Request, methods: list[str]) -> JSONResponse:
    """404 where there is no such path, 405 where the path has other methods."""
    status, kind, said = (
        (405, "method-not-allowed", "Method Not Allowed")
        if methods
        else (404, "not-found", "Not Found")
    )
    detail = f"{request.method} {request.url.path}: {said}. See /openapi.json"
    headers = {"Allow": ", ".join(methods)} if methods else {}
    return problem(request, status, kind, detail, (), headers)


def _beyond(request: Request, key: KeyRecord, found: Found) -> JSONResponse | None:
    """The answer where a key may not do what is asked, or does not know the rotor."""
    needed = found.rule.scope
    if needed not in key.scopes:
        remedy = f"use a key with scope {needed}"
        detail = f"{found.name} needs scope {needed}; key {key.id} has {', '.join(key.scopes)}"
        faults = [fault("scope", ", ".join(key.scopes), f"has not {needed}", remedy)]
        headers = {
            "WWW-Authenticate": f'Bearer realm="bladetwin", error="insufficient_scope", '
            f'scope="{needed}"'
        }
        text = f"{detail}. To mend it: {remedy}."
        return problem(request, 403, "scope-missing", text, faults, headers)
    if found.rotor is None:
        if key.rotors is None or found.rule.beyond:
            return None
        remedy = "use a key for all rotors"
        detail = f"key {key.id} is for {len(key.rotors)} rotor(s) only; {found.name} is for all"
        faults = [fault("rotor", None, "is not named by this route", remedy)]
        text = f"{detail}. To mend it: {remedy}."
        return problem(request, 403, "rotor-restricted", text, faults)
    if key.knows(found.rotor):
        return None
    return missing(request, NotFoundError("rotor", found.rotor, "POST /v1/rotors creates it"))
