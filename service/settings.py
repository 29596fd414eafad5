"""Every setting, in one object.

A setting is an environment variable ``BLADETWIN_<NAME>``; what is not set has the default below.
How they are read, and where the database's URL is: `service.environment`.
"""

from __future__ import annotations

import re
from typing import Literal

from pydantic import Field, field_validator

from service.environment import FromEnvironment
from service.outbound import networks

ORIGIN = re.compile(r"https?://[a-z0-9.\-]+(:\d{1,5})?|https?://\[[0-9a-f:]+\](:\d{1,5})?")
RATE_PER_S = 50.0  # of one caller, where keys are needed and nothing is set


def _origins(text: str) -> tuple[str, ...]:
    return tuple(one.strip() for one in text.split(",") if one.strip())


class Settings(FromEnvironment):
    """The settings of one process; frozen.

    >>> Settings.load({"BLADETWIN_WORKERS": "3"}).workers
    3
    """

    host: str = Field("127.0.0.1", description="address that `serve` listens on")
    port: int = Field(8000, ge=0, le=65535, description="port that `serve` listens on")
    api_processes: int = Field(
        1, ge=1, le=64, description="processes that answer requests at that port"
    )
    workers: int = Field(1, ge=0, le=256, description="worker processes that `serve` starts")
    sealers: int = Field(
        1, ge=0, le=256, description="processes that only seal; 0 = the workers do it themselves"
    )
    diagnosers: int = Field(
        1,
        ge=0,
        le=256,
        description="processes that only diagnose; 0 = diagnoses wait for "
        "`bladetwin worker --role diagnose`",
    )
    seal_after_s: float = Field(
        0.3, ge=0, le=3600, description="a provisional posterior is sealed when quiet for, s"
    )
    seal_within_s: float = Field(
        30.0, ge=0, le=86_400, description="and, where readings never pause, after this long, s"
    )
    migrate: Literal["auto", "always", "never"] = Field(
        "auto", description="migrate at `serve`: auto = SQLite yes, PostgreSQL no"
    )
    science: Literal["core", "fake"] = Field(
        "core", description="core = blade physics; fake = the small Gaussian twin for trials"
    )
    model_dir: str = Field(
        "", description="folder of a rebuilt rotor-blade model; empty = the shipped one"
    )
    particles: int = Field(
        10_000, ge=16, le=1_000_000, description="particles per blade where a rotor names none"
    )
    keys: Literal["auto", "always"] = Field(
        "auto", description="API keys: auto = needed unless it listens on the loopback; always"
    )
    rate_per_s: float | None = Field(
        None,
        ge=0,
        description="requests a second of a key, or of an address without one; 0 = any number; "
        "empty = 50 where keys are needed, else any number",
    )
    rate_burst: int = Field(
        200, ge=1, description="requests at once that a key may save up below its rate"
    )
    idempotency_h: float = Field(
        24.0, gt=0, le=8760, description="answers by Idempotency-Key are kept for, h"
    )
    cors_origins: str = Field(
        "",
        description="origins of pages that may call, with commas between, e.g. "
        "https://plant.example; empty = none",
    )
    max_body_mb: float = Field(32.0, gt=0, le=4096, description="largest request body, MiB")
    page_limit: int = Field(200, ge=1, le=10_000, description="most items on one page of a list")
    wait_max_s: float = Field(60.0, ge=0, le=3600, description="longest `timeout` of `wait_for`, s")
    lease_s: float = Field(6.0, gt=0, le=3600, description="a silent worker loses its rotor after")
    update_max_s: float = Field(
        3600.0,
        gt=0,
        le=604_800,
        description="an update or a sealing that takes longer counts as the death of its worker, "
        "whose process ends, s",
    )
    step_max_s: float = Field(
        14_400.0,
        gt=0,
        le=604_800,
        description="the same of a step of a diagnosis, of residuals or of a training, s",
    )
    max_attempts: int = Field(5, ge=1, le=100, description="attempts before a rotor is blocked")
    retry_base_s: float = Field(0.5, ge=0, description="first pause after a failed update, doubled")
    retry_max_s: float = Field(60.0, ge=0, description="longest pause after a failed update, s")
    poll_ms: float = Field(5.0, ge=1, le=1000, description="how often SQLite is looked at, ms")
    keep_versions: int = Field(20, ge=1, description="newest posterior versions that are kept")
    checkpoint_every: int = Field(
        50,
        ge=1,
        description="of older versions the last sealed one of so many is kept as a checkpoint; of "
        "2, 4, 8 … times as many, the older they are",
    )
    keep_events: int = Field(
        1000, ge=1, description="newest events (new versions, blockings) kept of each rotor"
    )
    heartbeat_s: float = Field(
        15.0, gt=0, le=3600, description="a silent stream of events gets a sign of life every, s"
    )
    webhook_key_file: str = Field(
        "", description="file of 32 or more random bytes, of which webhooks' secrets are made"
    )
    webhook_networks: str = Field(
        "",
        description="networks that are not public, or without TLS, to which webhooks may lead, "
        "with commas between, e.g. 10.20.0.0/16",
    )
    webhook_timeout_s: float = Field(
        10.0, gt=0, le=300, description="a receiver has to answer a webhook within, s"
    )
    webhook_max_attempts: int = Field(
        24, ge=1, le=1000, description="attempts before a webhook's delivery is dead"
    )
    webhook_retry_max_s: float = Field(3600.0, ge=0, description="longest pause between them, s")
    deliverers: int = Field(
        1,
        ge=0,
        le=16,
        description="processes that send to webhooks, where there is a key file; "
        "0 = `bladetwin worker --role deliver` does",
    )
    otel_endpoint: str = Field(
        "",
        description="OpenTelemetry collector that takes OTLP over HTTP, e.g. "
        "http://127.0.0.1:4318; empty = OTEL_EXPORTER_OTLP_ENDPOINT, or no traces",
    )
    cache_mb: float = Field(256.0, ge=0, description="decoded arrays kept for reads, MiB")
    answers_mb: float = Field(
        64.0, ge=0, description="answers kept as bytes in each API process, MiB; 0 = none"
    )
    states_mb: float = Field(
        384.0,
        ge=0,
        description="rotor states that a worker keeps in memory, MiB; that of the rotor seen last "
        "is kept whatever its size",
    )
    rotors_in_memory: int = Field(512, ge=1, description="and how many of them at most")
    readings_mb: float = Field(
        64.0,
        ge=0,
        description="readings that a worker keeps in memory, MiB; those of the rotor seen last are "
        "kept whatever their size",
    )
    log_level: Literal["debug", "info", "warning", "error"] = Field(
        "info", description="least level that is logged"
    )

    @field_validator("rate_per_s", mode="before")
    @classmethod
    def _empty_is_none(cls, value: object) -> object:
        return None if value == "" else value

    @field_validator("cors_origins")
    @classmethod
    def _are_origins(cls, value: str) -> str:
        for origin in _origins(value):
            if not ORIGIN.fullmatch(origin):
                raise ValueError(f"{origin!r} is no origin; write https://plant.example:8443")
        return value

    @field_validator("webhook_networks")
    @classmethod
    def _are_networks(cls, value: str) -> str:
        networks(value)
        return value

    @property
    def origins(self) -> tuple[str, ...]:
        """Origins of pages that may call the API."""
        return _origins(self.cors_origins)

    def rate(self, *, limited: bool) -> float:
        """Requests a second of one caller; 0: any number. `limited`: where nothing is set."""
        if self.rate_per_s is None:
            return RATE_PER_S if limited else 0.0
        return self.rate_per_s
