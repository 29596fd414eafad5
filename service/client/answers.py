"""What the service answers, for type checkers: plain dicts at run time.

Made from the schemas of the OpenAPI document by ``python -m tests.make_answer_types``; a test holds
both together. Moments are texts of ISO 8601, hours operating hours, `rests_on` what an answer
follows from.
"""

from __future__ import annotations

from typing import Any, Literal, NotRequired, TypedDict


class HealthContradictedSuspect(TypedDict):
    reading: str
    time_h: float
    misfit_nat: float


class HealthContradicted(TypedDict):
    blade: str
    misfit_nat: float
    own_nat: float
    rows: int
    bounded: NotRequired[bool]
    suspects: NotRequired[list[HealthContradictedSuspect]]


class HealthExchangedRival(TypedDict):
    blades: list[str]
    campaign: str | None
    time_h: list[float]


class HealthExchanged(TypedDict):
    blades: list[str]
    campaign: str | None
    time_h: list[float]
    readings: list[list[str]]
    gained_nat: float
    probability: float
    rivals: list[HealthExchangedRival]


class HealthFewDraw(TypedDict):
    blade: str
    share: float


class HealthNoisier(TypedDict):
    quantities: list[str]
    stated: bool
    times: float
    visits: int


class Health(TypedDict):
    status: Literal["ok", "degenerate", "contradicted", "unknown"]
    reasons: list[str]
    met_floor: bool | None
    contradicted: list[HealthContradicted]
    exchanged: NotRequired[list[HealthExchanged]]
    few_draws: NotRequired[list[HealthFewDraw]]
    noisier: NotRequired[list[HealthNoisier]]
    trusted: bool


class RestsOn(TypedDict):
    rotor: str
    version: int
    through_seq: int
    events_digest: str
    state_digest: str
    sealed: bool
    model: str
    model_version: str
    model_digest: str
    algorithm_version: str
    untold: list[str]


class Blade(TypedDict):
    id: str
    slot: str | None
    lot: str | None
    coating_lot: str | None
    installed_at: str | None
    time_h0: float | None
    added_seq: int
    retired_seq: int | None
    known: dict[str, Any] | None
    retired: bool


class Version(TypedDict):
    version: int
    through_seq: int
    sealed: bool
    state_digest: str
    events_digest: str
    model_version: str
    algorithm_version: str
    created_at: str


class Inspection(TypedDict):
    id: str
    blade: str
    quantity: str
    time_h: float
    values: list[Any] | None
    nodes: NotRequired[list[int] | None]
    unit: NotRequired[str | None]
    sigma: NotRequired[float | None]
    instrument: NotRequired[str | None]
    campaign: NotRequired[str | None]
    observed_at: NotRequired[str | None]
    replaces: NotRequired[str | None]
    count: NotRequired[int]
    seq: int
    status: Literal["counts", "replaced", "retracted"]
    received_at: str
    posted_by: str | None


class AcceptedItem(TypedDict):
    id: str
    seq: int
    status: Literal["accepted"]


class Accepted(TypedDict):
    items: list[AcceptedItem]
    head_seq: int


class JobProgress(TypedDict):
    what: str
    done: int
    total: int
    seconds_left: float | None


class Job(TypedDict):
    id: str
    kind: str
    status: str
    request: dict[str, Any]
    result: dict[str, Any] | None
    error: str | None
    progress: JobProgress | None
    attempts: int
    created_at: str
    finished_at: str | None


class Prediction(TypedDict):
    rotor: str
    blade: str
    quantity: str
    unit: str
    node: int | None
    probability: float
    instrument: str | None
    noise_from: Literal["readings", "prior"]
    time_h: list[float]
    mean: list[Any]
    sd: dict[str, list[Any]]
    lower: list[Any]
    upper: list[Any]
    quantiles: dict[str, list[Any]]
    held_from_h: float | None
    health: Health
    rests_on: RestsOn


class Life(TypedDict):
    rotor: str
    blade: str
    quantity: str
    unit: str
    node: int | None
    component: Literal["x", "y", "z"] | None
    limit: float
    time_h: list[float]
    passed: list[float]
    quantiles: dict[str, float | None]
    held_from_h: float | None
    health: Health
    rests_on: RestsOn


class RotorLifeBlade(TypedDict):
    id: str
    age_h: float | None
    age_by: Literal["campaign", "reading", "rotor"] | None
    passed: list[float]
    held_from_h: float | None


class RotorLife(TypedDict):
    rotor: str
    quantity: str
    unit: str
    node: int | None
    component: Literal["x", "y", "z"] | None
    limit: float
    ahead: bool
    time_h: list[float]
    any: list[float]
    expected: list[float]
    blades: list[RotorLifeBlade]
    health: Health
    rests_on: RestsOn


class SeriesRow(TypedDict):
    blade: str
    time: float
    value: float
    lower: float
    upper: float
    held: bool


class Parameter(TypedDict):
    mean: float
    sd: float
    r_hat: float | None
    quantiles: dict[str, float]


class ModelOutput(TypedDict):
    unit: str
    kind: str


class Model(TypedDict):
    id: str
    version: str
    digest: str
    state: str
    network: dict[str, Any]
    horizon_h: float
    node_count: int
    nodes: dict[str, int]
    time_h: list[float]
    outputs: dict[str, ModelOutput]
    summary: dict[str, Any]


class Surface(TypedDict):
    model: str
    version: str
    unit: str
    points: list[list[float]]
    triangles: list[list[int]]


class BladeAtOneHourReadingsLast(TypedDict):
    id: str
    time_h: float
    received_at: str


class BladeAtOneHourReadings(TypedDict):
    counting: int
    overruled: int
    last: BladeAtOneHourReadingsLast | None


class BladeAtOneHourPrediction(TypedDict):
    mean: Any
    sd: dict[str, Any]
    held_from_h: float | None


class BladeAtOneHour(TypedDict):
    id: str
    slot: str | None
    lot: str | None
    coating_lot: str | None
    installed_at: str | None
    time_h0: float | None
    added_seq: int
    retired_seq: int | None
    known: dict[str, Any] | None
    retired: bool
    readings: BladeAtOneHourReadings
    prediction: BladeAtOneHourPrediction


class Draws(TypedDict):
    rotor: str
    blade: str
    names: list[str]
    values: list[list[float]]
    of: int
    health: Health
    rests_on: RestsOn


class RotorDrawsShared(TypedDict):
    names: list[str]
    values: list[list[float]]


class RotorDrawsLocal(TypedDict):
    names: list[str]
    values: list[list[list[float]]]


class RotorDraws(TypedDict):
    rotor: str
    shared: RotorDrawsShared
    local: RotorDrawsLocal
    blades: list[str]
    of: int
    health: Health
    rests_on: RestsOn


class Field(TypedDict):
    rotor: str
    blade: str
    quantity: str
    unit: str
    time_h: float
    particles: int
    mean: list[Any]
    sd: list[Any]
    held_from_h: float | None
    health: Health
    rests_on: RestsOn


class WebhookDeliveries(TypedDict):
    pending: int
    delivered: int
    dead: int
    dropped: int


class Webhook(TypedDict):
    id: str
    url: str
    events: list[str]
    rotors: list[str] | None
    created_at: str
    deliveries: WebhookDeliveries


class Delivery(TypedDict):
    id: str
    number: int
    rotor: str
    event: str
    status: str
    attempts: int
    created_at: str
    tried_at: str | None
    not_before: str | None
    last_error: str | None


class Residual(TypedDict):
    inspection: str
    blade: str
    quantity: str
    campaign: str | None
    instrument: str | None
    time_h: float
    rotor_h: float
    visit: int
    part: int
    y: float
    mean: float
    sd: float
    z: float
    pit: float


class ResidualTest(TypedDict):
    grouping: str
    value: str | None
    statistic: Literal["mean", "variance", "autocorrelation"]
    count: int
    score: float
    p: float
    p_family: float
    alarm: bool


class Visit(TypedDict):
    visit: int
    readings: int
    from_h: float
    to_h: float
    health: str | None
    reasons: list[str]


class ResidualsAsOf(TypedDict):
    version: int
    through_seq: int
    events_digest: str
    model_digest: str
    particles: int
    computed_at: str


class Residuals(TypedDict):
    items: list[Residual]
    next: str | None
    rotor: str
    as_of: ResidualsAsOf | None
    pending: bool
    error: str | None
    visits: list[Visit]
    tests: list[ResidualTest]
    alarms: int
    family_wise_error: float
    draws: int
    freedom: float | None


class Planned(TypedDict):
    blade: str
    quantity: str
    time_h: float
    ahead_h: float
    instrument: str | None
    sigma: float | None
    sd_after: float
    narrower: float


class AdoptionModels(TypedDict):
    before: str
    after: str


class AdoptionNetworks(TypedDict):
    before: dict[str, Any] | None
    after: dict[str, Any] | None


class AdoptionChosen(TypedDict):
    alternative: int
    because: str


class Adoption(TypedDict):
    rotor: str
    diagnosis: str
    what: Literal["adoption", "back-out", "joining"]
    seq: int
    blade: str | None
    effects: list[dict[str, Any]]
    models: AdoptionModels | None
    networks: AdoptionNetworks
    readings_since: int | None
    unasked: bool
    chosen: AdoptionChosen | None
    posted_by: str | None
    at: str


class Course(TypedDict):
    name: str
    shape: str
    step_h: float | None


class Foreseen(TypedDict):
    mean: float
    sd: float
    z: float


class Placed(TypedDict):
    mean: float
    sd: float
    spread: float
    of: int
    at_low: int
    at_high: int


class PicturesReading(TypedDict):
    id: str
    blade: str
    quantity: str
    unit: str
    time_h: float
    rotor_h: float
    instrument: str | None
    campaign: str | None
    value: float
    before: Foreseen
    after: Foreseen


class PicturesCoursesBefore(TypedDict):
    mean: list[list[float]]
    sd: list[list[float]]
    low: list[list[float]]
    median: list[list[float]]
    high: list[list[float]]


class PicturesCourses(TypedDict):
    quantity: str
    unit: str
    time_h: list[float]
    blades: list[str]
    now_h: NotRequired[list[float]]
    before: PicturesCoursesBefore
    after: PicturesCoursesBefore


class PicturesAmplitudePrior(TypedDict):
    low: float
    high: float
    mean: float
    sd: float


class PicturesAmplitude(TypedDict):
    name: str
    unit: str
    prior: PicturesAmplitudePrior
    quantiles: list[float]
    at_bound: str | None
    x: list[float]
    prior_density: list[float]
    density: list[float]


class PicturesParameter(TypedDict):
    name: str
    level: Literal["shared", "local"]
    unit: str
    low: float
    high: float
    effect: bool
    before: Placed | None
    after: Placed | None


class Pictures(TypedDict):
    schema: int
    readings: list[PicturesReading]
    readings_not_shown: int
    courses: PicturesCourses | None
    amplitudes: list[PicturesAmplitude]
    parameters: list[PicturesParameter]


class SeparatingRival(TypedDict):
    names: list[str]
    called: NotRequired[list[str]]
    weight: float


class SeparatingSingleExpected(TypedDict):
    mean: float
    sd: float


class SeparatingSingle(TypedDict):
    blade: str
    quantity: str
    time_h: float
    ahead_h: float
    instrument: str | None
    sigma: float | None
    gain_nat: float
    share: float
    settled: float
    unit: str
    blades_alike: int
    expected: list[SeparatingSingleExpected]


class SeparatingSet(TypedDict):
    blade: str
    quantity: str
    time_h: float
    ahead_h: float
    instrument: str | None
    sigma: float | None
    gain_nat: float
    share: float
    settled: float


class SeparatingCampaign(TypedDict):
    quantity: str
    ahead_h: float
    blades: int
    instrument: str | None
    sigma: float | None
    nodes: int | None
    gain_nat: float
    share: float
    settled: float


class Separating(TypedDict):
    rivals: list[SeparatingRival]
    entropy_nat: float
    single: list[SeparatingSingle]
    set: list[SeparatingSet]
    campaigns: NotRequired[list[SeparatingCampaign]]


class FoundCalibrated(TypedDict):
    names: list[str]
    effects: NotRequired[list[Course]]
    gained_nat: float | None


class FoundNoRoom(TypedDict):
    names: list[str]
    why: str


class FoundTried(TypedDict):
    what: str
    log_bf: float | None


class FoundConcern(TypedDict):
    effect: str
    blades: int
    all: float
    share: float
    some_nat: float
    those: list[str]
    stands: bool


class FoundPlacebo(TypedDict):
    effect: str
    by: str
    count: int
    won: int
    gained_nat: float
    best_nat: float
    stands: bool


class FoundParameters(TypedDict):
    before: dict[str, Any]
    after: dict[str, Any]


class FoundReadings(TypedDict):
    delivered: int
    used: int


class FoundAdds(TypedDict):
    parameters: NotRequired[list[dict[str, Any]]]
    drifts: NotRequired[list[dict[str, Any]]]
    biases: NotRequired[list[dict[str, Any]]]
    quantities: NotRequired[dict[str, dict[str, Any]]]


class FoundWidenedSd(TypedDict):
    before: float
    after: float


class FoundWidened(TypedDict):
    quantity: str
    discrepancy: dict[str, Any]
    gained_nat: float
    borne_out: bool
    time_h: float
    share: float
    sd: FoundWidenedSd


class FoundNoticedFamilie(TypedDict):
    family: str
    whom: str
    kind: str
    on: str
    target: str
    how: str
    of: str
    unit: str
    least: float | None
    easiest: str
    most: float | None
    hardest: str


class FoundNoticed(TypedDict):
    probability: float
    alarm: float
    families: list[FoundNoticedFamilie]


class FoundCondition(TypedDict):
    fault: NotRequired[str | None]
    input: str
    value: float
    holds: bool
    blades: list[str]
    before: dict[str, Any]
    after: dict[str, Any]


class FoundAlternativesEachAdoption(TypedDict):
    model: str
    effects: list[dict[str, Any]]
    adds: FoundAdds


class FoundAlternativesEach(TypedDict):
    effects: list[Course]
    share: float
    mean: float
    sd: float
    number: NotRequired[int]
    adoption: NotRequired[FoundAlternativesEachAdoption]


class FoundAlternatives(TypedDict):
    quantity: str
    time_h: float
    blades: list[str]
    before: SeparatingSingleExpected
    together: SeparatingSingleExpected
    each: list[FoundAlternativesEach]


class FoundRestsOn(TypedDict):
    rotor: str
    through_seq: int
    events_digest: str
    model: str
    model_version: str
    model_digest: str
    particles: int
    seed: int


class Found(TypedDict):
    verdict: Literal["adequate", "effect", "not separable", "unattributed"]
    names: list[str]
    beside: NotRequired[list[str]]
    several: NotRequired[list[str]]
    reasons: list[str]
    p: float | None
    dealt: NotRequired[int]
    p_after: float | None
    effects: list[dict[str, Any]]
    claimed: bool
    gained_nat: float | None
    evidence: dict[str, float | None]
    calibrated: list[FoundCalibrated]
    no_room: list[FoundNoRoom]
    tried: list[FoundTried]
    holds: list[dict[str, Any]]
    concerns: NotRequired[list[FoundConcern]]
    placebos: NotRequired[list[FoundPlacebo]]
    parameters: FoundParameters
    readings: FoundReadings
    models: AdoptionModels
    before_after: dict[str, Any] | None
    adds: NotRequired[FoundAdds | None]
    widened: NotRequired[FoundWidened | None]
    noticed: NotRequired[FoundNoticed | None]
    conditions: NotRequired[list[FoundCondition]]
    not_adopted: NotRequired[str]
    pictures: NotRequired[Pictures | None]
    separating: NotRequired[Separating | None]
    alternatives: NotRequired[FoundAlternatives | None]
    rests_on: FoundRestsOn


class DiagnosisRequestBecauseTest(TypedDict):
    grouping: str
    value: str | None
    statistic: Literal["mean", "variance", "autocorrelation"]


class DiagnosisRequestBecause(TypedDict):
    version: int
    readings: int
    alarms: int
    tests: list[DiagnosisRequestBecauseTest]


class DiagnosisRequest(TypedDict):
    families: list[dict[str, Any]]
    compare: bool
    horizon_h: float
    through_seq: int
    because: NotRequired[DiagnosisRequestBecause]


class Diagnosis(TypedDict):
    id: str
    rotor: str
    status: Literal["queued", "running", "done", "failed", "cancelled"]
    request: DiagnosisRequest
    progress: JobProgress | None
    error: str | None
    attempts: int
    created_at: str
    finished_at: str | None
    result: Found | None
    adoption: Adoption | None


class ModelListed(TypedDict):
    id: str
    version: str
    digest: str
    state: str


class RotorListedLastError(TypedDict):
    error: str | None
    event: str | None


class RotorListed(TypedDict):
    id: str
    model: str
    model_version: str
    particles: int
    seed: int
    network: dict[str, Any] | None
    adopt: Literal["never", "effect"]
    diagnose: Literal["never", "alarm", "readings"]
    created_at: str
    policy_since: str | None
    origin: str | None
    head_seq: int
    applied_seq: int
    version: int
    status: Literal["blocked", "pending", "current"]
    attempts: int
    last_error: RotorListedLastError | None
    sealed: bool | None
    health: Health | None


class RotorMade(TypedDict):
    id: str
    model: str
    model_version: str
    particles: int
    seed: int
    network: dict[str, Any] | None
    adopt: Literal["never", "effect"]
    diagnose: Literal["never", "alarm", "readings"]
    created_at: str
    blades: list[Blade]


class Rotor(TypedDict):
    id: str
    model: str
    model_version: str
    particles: int
    seed: int
    network: dict[str, Any] | None
    adopt: Literal["never", "effect"]
    diagnose: Literal["never", "alarm", "readings"]
    created_at: str
    policy_since: str | None
    origin: str | None
    head_seq: int
    applied_seq: int
    version: int
    status: Literal["blocked", "pending", "current"]
    attempts: int
    last_error: RotorListedLastError | None
    blades: list[Blade]
    posterior: Version | None
    health: Health | None
    effects: list[dict[str, Any]]


class Standing(TypedDict):
    id: str
    model: str
    model_version: str
    particles: int
    seed: int
    network: dict[str, Any] | None
    adopt: Literal["never", "effect"]
    diagnose: Literal["never", "alarm", "readings"]
    created_at: str
    policy_since: str | None
    origin: str | None
    head_seq: int
    applied_seq: int
    version: int
    status: Literal["blocked", "pending", "current"]
    attempts: int
    last_error: RotorListedLastError | None


class KeptVersion(TypedDict):
    version: int
    through_seq: int
    sealed: bool
    state_digest: str
    events_digest: str
    model_version: str
    algorithm_version: str
    created_at: str
    health: Health


class RotorPosterior(TypedDict):
    rotor: str
    parameters: dict[str, Parameter]
    names: list[str]
    correlation: list[list[float]]
    ess: float
    r_hat: float | None
    draws: int
    health: Health
    rests_on: RestsOn


class BladePosterior(TypedDict):
    rotor: str
    parameters: dict[str, Parameter]
    names: list[str]
    correlation: list[list[float]]
    ess: float
    r_hat: float | None
    draws: int
    health: Health
    rests_on: RestsOn
    blade: str


class PlanTarget(TypedDict):
    blade: str | None
    quantity: str | None
    time_h: float | None
    parameter: str | None
    unit: str
    mean: float
    sd: float


class Plan(TypedDict):
    rotor: str
    target: PlanTarget
    single: list[Planned]
    set: list[Planned]
    health: Health
    rests_on: RestsOn


class DiagnosisListed(TypedDict):
    id: str
    rotor: str
    status: Literal["queued", "running", "done", "failed", "cancelled"]
    request: DiagnosisRequest
    progress: JobProgress | None
    error: str | None
    attempts: int
    created_at: str
    finished_at: str | None
    verdict: str | None
    names: list[str] | None
    not_adopted: str | None


class Adopted(TypedDict):
    adoption: Adoption
    joined: list[str]
    head_seq: int


class BackedOut(TypedDict):
    adoption: Adoption
    head_seq: int


class WebhookMade(TypedDict):
    webhook: Webhook
    secret: str | None


class WebhookDeleted(TypedDict):
    id: str
    deleted: bool
