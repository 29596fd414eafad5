"""Types of what the entries of a rotor's file hold, beside the columns of the log.

Digests guard against damage; a file that somebody made agrees with all of them and may still have
a text where a number is expected. Fields that came later are optional, as older files lack them.
"""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, FiniteFloat, ValidationError


class Body(BaseModel):
    """Fields beside these belong to no answer that reads them, and are kept as they are."""

    model_config = ConfigDict(extra="allow", strict=True, frozen=True)


class ReadingBody(Body):
    id: str
    blade: str
    quantity: str
    time_h: FiniteFloat
    values: list[FiniteFloat] | list[list[FiniteFloat]]
    nodes: list[int] | None = None
    unit: str | None = None
    sigma: FiniteFloat | None = None
    instrument: str | None = None
    campaign: str | None = None
    observed_at: str | None = None
    replaces: str | None = None


class AmplitudeBody(Body):
    mean: FiniteFloat | None = None
    sd: FiniteFloat | None = None
    of: str | None = None
    unit: str | None = None


class EffectBody(Body):
    name: str
    words: str | None = None
    cause: str | None = None
    whom: str | None = None
    value: str | None = None
    shape: str | None = None
    clock: str | None = None
    step_h: FiniteFloat | None = None
    amplitude: AmplitudeBody | None = None


class ModelsBody(Body):
    before: str
    after: str


class ChosenBody(Body):
    alternative: int
    because: str


class AdoptionBody(Body):
    """Of an adoption, a back-out, or a blade that joins an effect."""

    number: int
    diagnosis: str
    effects: list[EffectBody]
    before: dict[str, Any] | None
    after: dict[str, Any] | None
    models: ModelsBody | None = None
    through_seq: int | None = None
    readings_since: int | None = None
    unasked: bool = False
    chosen: ChosenBody | None = None
    blade: str | None = None


class SealedBody(Body):
    """The newest sealed state where the file was written, to compare an import with."""

    through_seq: int
    events_digest: str
    digest: str
    algorithm_version: str


class ManifestBody(Body):
    head_seq: int
    state: SealedBody | None = None


def first_fault(error: ValidationError) -> str:
    """Where, and what of it: one line."""
    first = error.errors(include_input=False, include_url=False)[0]
    return f"{'.'.join(map(str, first['loc']))}: {first['msg']}"
