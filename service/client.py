"""A small typed client of the REST service, for users' programs and for the demonstration.

with Client("http://127.0.0.1:8000") as twin:
    twin.create_rotor("r1", blades=["B01", "B02"])
    seq = twin.post_inspections("r1", [{"id": "i1", "blade": "B01", "quantity": "elongation",
                                        "time_h": 8000.0, "value": 0.11, "unit": "mm"}])
    twin.wait_for("r1", seq)
    bands = twin.prediction("r1", "B01", "elongation", times=[24000, 50000])
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from urllib.parse import quote

import httpx

from core.errors import BladetwinError
from service.signing import SignatureError as SignatureError
from service.signing import verified
from service.sse import events

Json = dict[str, Any]
Blade = str | Mapping[str, Any]


class ProblemError(BladetwinError):
    """The service refused: `status`, `problem` (RFC 9457) and its `faults` say why."""

    def __init__(self, response: httpx.Response) -> None:
        self.status = response.status_code
        try:
            self.problem: Json = response.json()
        except ValueError:
            self.problem = {"detail": response.text[:500]}
        self.faults: list[Json] = self.problem.get("faults", [])
        detail = self.problem.get("detail", "")
        request = response.request
        super().__init__(f"{request.method} {request.url.path}: {self.status}: {detail}")


class BlockedError(BladetwinError):
    """The rotor is blocked; `rotor` is its answer with the error and the event named."""

    def __init__(self, rotor: Json) -> None:
        self.rotor = rotor
        super().__init__(f"rotor {rotor['id']} is blocked: {rotor['last_error']}")


def _path(*parts: str) -> str:
    return "/v1/" + "/".join(quote(part, safe="") for part in parts)


def _which(version: int | None, at: str | None) -> dict[str, str]:
    """The query of a version (a number) or of a moment (ISO 8601 with an offset)."""
    told = {"version": None if version is None else str(version), "at": at}
    return {name: value for name, value in told.items() if value is not None}


def read_webhook(
    secret: str, headers: Mapping[str, str], body: bytes, *, tolerance_s: float = 300.0
) -> Json:
    """What a webhook's receiver was told: ``{"id", "type", "timestamp", "data"}``.

    secret    as the webhook's creation answered it
    headers   of the request; body: its bytes as they came, not parsed and written again
    id        the same each time a message is sent: one that was seen before is to be dropped

    Raises SignatureError where the service did not sign this, or longer ago than `tolerance_s`.
    """
    message_id = verified(secret, headers, body, tolerance_s=tolerance_s)
    told: Json = json.loads(body)
    return told | {"id": message_id}


class Client:
    """Talks to one service, with an API key where it asks for one.

    `http` may be given instead, e.g. the test client of an application.
    """

    def __init__(
        self,
        base_url: str = "http://127.0.0.1:8000",
        *,
        key: str | None = None,
        timeout: float = 90.0,
        http: httpx.Client | None = None,
    ) -> None:
        headers = {} if key is None else {"Authorization": f"Bearer {key}"}
        self._http = http or httpx.Client(base_url=base_url, timeout=timeout, headers=headers)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        self._http.close()

    def _call(self, method: str, path: str, **kw: Any) -> Json:
        response = self._http.request(method, path, **kw)
        if response.is_error:
            raise ProblemError(response)
        answer: Json = response.json()
        return answer

    def ready(self, patience_s: float = 30.0) -> None:
        """Return as soon as the service is ready; TimeoutError when it does not become so."""
        end = time.monotonic() + patience_s
        while time.monotonic() < end:
            try:
                if self._http.get("/readyz").status_code == 200:
                    return
            except httpx.TransportError:
                pass
            time.sleep(0.05)
        raise TimeoutError(f"{self._http.base_url} was not ready within {patience_s:g} s")

    def models(self) -> list[Json]:
        items: list[Json] = self._call("GET", "/v1/models")["items"]
        return items

    def model(self, name: str) -> Json:
        return self._call("GET", _path("models", name))

    def register(self, builtin: str, patience_s: float = 600.0) -> Json:
        """A built-in model registered, and what it is; one that is there already stays as it is.

        Raises TimeoutError when it takes longer than `patience_s`, RuntimeError when it fails.
        """
        job: Json = self._call("POST", "/v1/models", json={"builtin": builtin})["job"]
        end = time.monotonic() + patience_s
        while job["status"] in ("queued", "running"):
            if time.monotonic() > end:
                raise TimeoutError(f"{builtin} was not registered within {patience_s:g} s")
            time.sleep(0.1)
            job = self._call("GET", _path("jobs", job["id"]))
        if job["status"] != "done":
            raise RuntimeError(f"{builtin} was not registered: {job}")
        return self.model(builtin)

    def upload_model(
        self,
        name: str,
        runs: str | Path,
        network: bytes | str,
        *,
        leave_out: Sequence[str] = (),
        patience_s: float = 7200.0,
        progress: Callable[[str, int, int], None] = lambda what, done, total: None,
    ) -> Json:
        """Runs and network sent, and the job when it has ended: ``status`` is done or failed.

        runs      a netCDF file (`core.archive.source`); network: its text, YAML or JSON
        progress  called with (what, done, total) as the training goes on
        Its ``result`` has ``version``, ``quality`` and ``warnings``, or ``faults`` and
        ``warnings``.

        Raises TimeoutError when it takes longer than `patience_s`.
        """
        form = {"id": name} | ({"leave_out": ",".join(leave_out)} if leave_out else {})
        told = network.encode() if isinstance(network, str) else network
        with open(runs, "rb") as handle:
            files = {"network": ("network.yaml", told), "runs": ("runs.nc", handle)}
            job: Json = self._call("POST", "/v1/models", data=form, files=files)["job"]
        end = time.monotonic() + patience_s
        while job["status"] in ("queued", "running"):
            if time.monotonic() > end:
                raise TimeoutError(f"{name} was not trained within {patience_s:g} s")
            time.sleep(0.2)
            job = self._call("GET", _path("jobs", job["id"]))
            if job["progress"] is not None:
                progress(*(job["progress"][key] for key in ("what", "done", "total")))
        return job

    def create_rotor(
        self,
        rotor: str,
        *,
        blades: Sequence[Blade],
        model: str = "rotor-blade",
        particles: int | None = None,
        seed: int | None = None,
        network: Mapping[str, Any] | None = None,
        adopt: str | None = None,
    ) -> Json:
        """Create a rotor; a blade is an id or ``{"id", "slot"?, "lot"?, "known"?, …}``.

        network   what it varies of the model's network, e.g.
                  ``{"quantities": {"elongation": {"by_instrument": True}}, "forgetting_h": 2e4}``
        adopt     ``effect``: a diagnosis that names an effect is adopted by itself
        """
        listed = [{"id": b} if isinstance(b, str) else dict(b) for b in blades]
        body: Json = {"id": rotor, "model": model, "blades": listed}
        body |= {} if particles is None else {"particles": particles}
        body |= {} if seed is None else {"seed": seed}
        body |= {} if network is None else {"network": dict(network)}
        body |= {} if adopt is None else {"adopt": adopt}
        return self._call("POST", "/v1/rotors", json=body)

    def rotor(self, rotor: str, *, version: int | None = None, at: str | None = None) -> Json:
        """The rotor as it stands; with a version or a moment, its blades and posterior then."""
        return self._call("GET", _path("rotors", rotor), params=_which(version, at))

    def add_blade(self, rotor: str, blade: Blade) -> int:
        """Add a blade; the sequence number to wait for."""
        body = {"id": blade} if isinstance(blade, str) else dict(blade)
        return int(self._call("POST", _path("rotors", rotor, "blades"), json=body)["head_seq"])

    def retire_blade(self, rotor: str, blade: str) -> int:
        path = _path("rotors", rotor, "blades", blade, "retirement")
        return int(self._call("POST", path)["head_seq"])

    def post_inspections(self, rotor: str, inspections: Sequence[Mapping[str, Any]]) -> int:
        """Post readings, all or nothing; the sequence number to wait for."""
        body = {"inspections": [dict(one) for one in inspections]}
        return int(self._call("POST", _path("rotors", rotor, "inspections"), json=body)["head_seq"])

    def retract(self, rotor: str, inspection: str) -> int:
        path = _path("rotors", rotor, "inspections", inspection, "retraction")
        return int(self._call("POST", path)["head_seq"])

    def wait_for(self, rotor: str, seq: int, patience_s: float = 120.0) -> Json:
        """The rotor once everything up to `seq` counts; BlockedError, TimeoutError."""
        end = time.monotonic() + patience_s
        while (left := end - time.monotonic()) > 0:
            answer = self._call(
                "GET",
                _path("rotors", rotor),
                params={"wait_for": seq, "timeout": min(20.0, left)},
            )
            if answer["status"] == "blocked":
                raise BlockedError(answer)
            if answer["version"] > 0 and answer["applied_seq"] >= seq:
                return answer
        raise TimeoutError(f"rotor {rotor}: {seq} was not applied within {patience_s:g} s")

    def wait_sealed(self, rotor: str, patience_s: float = 120.0) -> Json:
        """The rotor once its newest posterior is sealed."""
        end = time.monotonic() + patience_s
        while time.monotonic() < end:
            answer = self.wait_for(rotor, 0, max(0.001, end - time.monotonic()))
            if answer["posterior"]["sealed"] and answer["status"] == "current":
                return answer
            time.sleep(0.05)
        raise TimeoutError(f"rotor {rotor} was not sealed within {patience_s:g} s")

    def posterior(
        self,
        rotor: str,
        blade: str | None = None,
        *,
        version: int | None = None,
        at: str | None = None,
    ) -> Json:
        """The shared parameters' posterior, or one blade's; of a version, or as of a moment."""
        parts = ("rotors", rotor) + (() if blade is None else ("blades", blade)) + ("posterior",)
        return self._call("GET", _path(*parts), params=_which(version, at))

    def prediction(
        self,
        rotor: str,
        blade: str,
        quantity: str | None = None,
        *,
        times: Sequence[float] | None = None,
        node: int | str | None = None,
        probability: float = 0.95,
        instrument: str | None = None,
        version: int | None = None,
        at: str | None = None,
    ) -> Json:
        """Bands of a quantity by source; with an instrument, of a reading by it.

        quantity   default: the model's first one

        ``answer["health"]["trusted"]`` is False where the state behind it says why it is not.
        """
        params: dict[str, str] = {"probability": repr(probability)}
        if quantity is not None:
            params["quantity"] = quantity
        if times is not None:
            params["times"] = ",".join(repr(float(t)) for t in times)
        if node is not None:
            params["node"] = str(node)
        if instrument is not None:
            params["instrument"] = instrument
        params |= _which(version, at)
        return self._call(
            "GET", _path("rotors", rotor, "blades", blade, "prediction"), params=params
        )

    def plan(
        self,
        rotor: str,
        *,
        blade: str | None = None,
        quantity: str | None = None,
        time_h: float | None = None,
        parameter: str | None = None,
        count: int = 3,
    ) -> Json:
        """Inspections by how much they would narrow a blade's prediction, or a parameter.

        time_h   hour of the prediction [h]; None: the model's last
        """
        params: dict[str, str] = {"count": str(count)}
        params |= {} if time_h is None else {"time_h": repr(float(time_h))}
        for name, value in (("blade", blade), ("quantity", quantity), ("parameter", parameter)):
            params |= {} if value is None else {name: value}
        return self._call("GET", _path("rotors", rotor, "plan"), params=params)

    def events(
        self, rotor: str, *, after: int | None = None, silence_s: float = 60.0
    ) -> Iterator[Json]:
        """Hints as they come: ``{"id", "event", "rotor", "version", …}``; ends with the server.

        after   id of the last event known; None: begin with the newest. An event ``reset`` says
                that some in between are no longer kept: read the rotor again.
        silence_s   without even a heartbeat the connection is lost: httpx.ReadTimeout
        """
        params = {} if after is None else {"after": str(after)}
        with self._http.stream(
            "GET", _path("rotors", rotor, "events"), params=params, timeout=silence_s
        ) as answer:
            if not answer.is_success:
                answer.read()
                raise ProblemError(answer)
            yield from events(answer.iter_lines())

    def diagnose(
        self,
        rotor: str,
        *,
        families: Sequence[Mapping[str, Any]] = (),
        compare: bool = True,
        horizon_h: float | None = None,
    ) -> Json:
        """Begin to look for effects that the model lacks; the diagnosis as it stands.

        families    beside the built-in ones (`core.diagnosis.Family.to_json`)
        compare     whether both models are held against readings that neither used
        horizon_h   hour of the forecasts that are compared [h]; None: 50,000
        """
        body: Json = {"compare": compare}
        body |= {"families": [dict(one) for one in families]} if families else {}
        body |= {} if horizon_h is None else {"horizon_h": horizon_h}
        path = _path("rotors", rotor, "diagnoses")
        found: Json = self._call("POST", path, json=body)["diagnosis"]
        return found

    def diagnoses(self, rotor: str) -> Iterator[Json]:
        """Every diagnosis of a rotor, the newest first, page by page."""
        yield from self._pages(_path("rotors", rotor, "diagnoses"))

    def diagnosis(self, rotor: str, diagnosis: str) -> Json:
        return self._call("GET", _path("rotors", rotor, "diagnoses", diagnosis))

    def cancel_diagnosis(self, rotor: str, diagnosis: str) -> Json:
        """End a diagnosis that is queued or running; one that has ended stays as it is."""
        return self._call("DELETE", _path("rotors", rotor, "diagnoses", diagnosis))

    def adopt(self, rotor: str, diagnosis: str) -> Json:
        """The effects of a diagnosis enter the rotor's model; `head_seq` is what to wait for."""
        path = _path("rotors", rotor, "diagnoses", diagnosis, "adoption")
        return self._call("POST", path)

    def back_out(self, rotor: str, diagnosis: str) -> Json:
        """The network before the adoption comes back; `head_seq` is what to wait for."""
        path = _path("rotors", rotor, "diagnoses", diagnosis, "adoption")
        return self._call("DELETE", path)

    def adoptions(self, rotor: str) -> Iterator[Json]:
        """What was adopted and backed out, in order, page by page."""
        yield from self._pages(_path("rotors", rotor, "adoptions"))

    def _pages(self, path: str, **asked: Any) -> Iterator[Json]:
        params = {name: str(value) for name, value in asked.items() if value is not None}
        while True:
            page = self._call("GET", path, params=params)
            yield from page["items"]
            if page["next"] is None:
                return
            params["cursor"] = page["next"]

    def create_webhook(
        self,
        webhook: str,
        url: str,
        *,
        events: Sequence[str] | None = None,
        rotors: Sequence[str] | None = None,
    ) -> Json:
        """Have what happens sent to a URL: ``{"webhook", "secret"}``; the secret is shown once.

        events   some of sealed, blocked, alarm, diagnosed; None: all
        rotors   the only ones; None: all
        """
        body: Json = {"id": webhook, "url": url}
        body |= {} if events is None else {"events": list(events)}
        body |= {} if rotors is None else {"rotors": list(rotors)}
        return self._call("POST", "/v1/webhooks", json=body)

    def webhook(self, webhook: str) -> Json:
        """A webhook, with how many deliveries are pending, delivered and dead."""
        return self._call("GET", _path("webhooks", webhook))

    def delete_webhook(self, webhook: str) -> Json:
        return self._call("DELETE", _path("webhooks", webhook))

    def deliveries(self, webhook: str, status: str | None = None) -> Iterator[Json]:
        """What a webhook was or is to be told, the newest first, page by page."""
        yield from self._pages(_path("webhooks", webhook, "deliveries"), status=status)

    def report(self, rotor: str, diagnosis: str, *, limit: float | None = None) -> str:
        """A finished diagnosis as one HTML file to hand on.

        limit  of the quantity that is forecast [its unit]: shows by how much remaining life moves
        """
        path = _path("rotors", rotor, "diagnoses", diagnosis, "report")
        params = {} if limit is None else {"limit": repr(float(limit))}
        response = self._http.get(path, params=params)
        if response.is_error:
            raise ProblemError(response)
        return response.text

    def retry_delivery(self, webhook: str, delivery: str) -> Json:
        """Have a dead delivery sent again."""
        return self._call("POST", _path("webhooks", webhook, "deliveries", delivery, "retry"))

    def residuals(self, rotor: str, **filters: str) -> Json:
        """The first page of residuals, with tests; `filters`: blade, quantity, campaign, cursor."""
        return self._call("GET", _path("rotors", rotor, "residuals"), params=filters)

    def retry(self, rotor: str) -> Json:
        return self._call("POST", _path("rotors", rotor, "retry"))
