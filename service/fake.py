"""A small exact twin in memory: the science's seam for tests, trials and users' own tests.

Each blade elongates at a rate of its own around the rotor's::

    r_b = m + l_b,   m ~ N(0.5, 0.1²),   l_b ~ N(0, 0.2²)            [mm per 50,000 h]
    y   = r_b h + e,  h = t / 50,000,    e ~ N(0, sigma²)             [mm]

with sigma given by the reading or 0.02 mm. All is conjugate, so posterior and prediction are exact:
with n = Σ h²/sigma² and s = Σ h y/sigma² of a blade, its message about m is N(s/n, 1/n + 0.2²).
A diagnosis asks by chi-square whether each blade's elongations lie on a line through zero; it knows
no effects, so that what it finds is unattributed.
A deformation at node k of N is (0, 0, r_b h (k+1)/N); ceeq there is r_b h (k+1)/(100 N).
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from dataclasses import field as default
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, ndtri

from core.digest import array_digest, state_digest
from core.errors import InputError
from core.network import Network, Parameter, Quantity
from core.observation import Inspection, digest_of
from core.prior import Prior
from core.rng import stream
from service.ports import (
    Array,
    BladeRecord,
    Draws,
    Field,
    Forward,
    Get,
    JointDraws,
    Json,
    Mesh,
    ModelCard,
    NoiseFrom,
    Output,
    PlanTarget,
    Progress,
    RotorSpec,
    Surface,
)

MEAN, SD, SCATTER, SIGMA = 0.5, 0.1, 0.2, 0.02
HORIZON_H = 50_000.0
ALARM = 0.05
LEVELS = (0.025, 0.16, 0.5, 0.84, 0.975)


def fake_network() -> Network:
    """The declaration of the conjugate twin."""
    noise = Prior("log_uniform", 1e-3, 0.2)
    return Network(
        name="fake",
        parameters=(
            Parameter("rate", "shared", Prior.gaussian(MEAN, SD), "mm"),
            Parameter("offset", "local", Prior.gaussian(0.0, SCATTER), "mm"),
        ),
        quantities=(
            Quantity("elongation", "mm", "scalar", noise, -5.0, 50.0),
            Quantity("deformation", "mm", "vector", noise, -50.0, 50.0),
            Quantity("ceeq", "1", "field", noise, 0.0, 0.5, "critical"),
        ),
    )


@dataclass(frozen=True, slots=True)
class FakeState:
    """Sufficient statistics: ``column/<blade>`` (n, s) and ``shared/moments`` (mean, variance)."""

    meta: Mapping[str, Any]
    arrays: Mapping[str, Array]

    @property
    def fresh(self) -> frozenset[str]:
        """All of them: nothing is taken from the state before."""
        return frozenset(self.arrays)

    @property
    def digest(self) -> str:
        return state_digest(self.meta, {n: array_digest(a) for n, a in self.arrays.items()})


@dataclass(frozen=True, slots=True)
class FakePrediction:
    """Bands of one quantity, by source."""

    time_h: Array
    mean: Array
    sd: Mapping[str, Array]
    lower: Array
    upper: Array
    quantiles: Mapping[float, Array]
    instrument: str | None = None
    noise_from: NoiseFrom = "prior"


@dataclass(frozen=True, slots=True)
class FakeForward:
    """(m + l_b) h at a node, known exactly."""

    card: ModelCard
    quantity: str
    names: tuple[str, ...] = ("rate", "offset")
    units: tuple[str, ...] = ("mm", "mm")
    low: tuple[float, ...] = (-5.0, -5.0)
    high: tuple[float, ...] = (5.0, 5.0)

    def __call__(
        self, x: Sequence[float], times: Sequence[float], node: int | None
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        scale = along(self.card, self.quantity, node)
        y = sum(x) * np.asarray(times, float)[:, None] / HORIZON_H * scale
        y = y if self.quantity == "deformation" else y[:, 0]
        return y, np.zeros_like(y)


def along(card: ModelCard, quantity: str, node: int | None) -> NDArray[np.float64]:
    """What a quantity at a node has of the elongation at the tip: (1,), of a deformation (3,)."""
    if quantity == "elongation":
        return np.ones(1)
    k = card.nodes["critical"] if node is None else node
    scale = np.array([0.0, 0.0, 1.0]) if quantity == "deformation" else np.array([0.01])
    return scale * (k + 1) / card.node_count


@dataclass(frozen=True, slots=True)
class FakeScience:
    """The twin. `delay_s` makes an update slow; `provisional` makes quick updates unsealed."""

    node_count: int = 6448
    delay_s: float = 0.0
    provisional: bool = False
    network: Network = default(default_factory=fake_network)
    builtins: tuple[str, ...] = ("rotor-blade",)

    def builtin(self, name: str) -> ModelCard:
        if name not in self.builtins:
            raise InputError("builtin", name, "is no built-in model", f"use {self.builtins[0]}")
        digest = hashlib.sha256(json.dumps(self.network.to_json()).encode()).hexdigest()
        return ModelCard(
            id=name,
            version=f"fake-{digest[:8]}",
            digest=digest,
            network=self.network,
            horizon_h=HORIZON_H,
            node_count=self.node_count,
            nodes={"tip": self.node_count - 1, "critical": 3},
            time_h=tuple(np.linspace(0.0, HORIZON_H, 6).tolist()),
            outputs={q.name: Output(q.unit, q.kind) for q in self.network.quantities},
            summary={"what": "conjugate Gaussian twin"},
        )

    def train(
        self,
        name: str,
        network: Network,
        runs: bytes,
        leave_out: Sequence[str],
        facts: Json,
        progress: Progress,
    ) -> tuple[ModelCard, bytes]:
        """Nothing is learnt here: the card is the twin's own, under another name."""
        for done in range(3):
            progress("pretending to train", done, 3)
            time.sleep(self.delay_s)
        artefact = hashlib.sha256(runs).digest()
        return self.opened(name, artefact), artefact

    def opened(self, name: str, artefact: bytes) -> ModelCard:
        card = self.builtin(self.builtins[0])
        told = {"artefact": hashlib.sha256(artefact).hexdigest(), "kind": "a twin's"}
        return replace(card, id=name, version=f"fake-{artefact[:4].hex()}", summary=told)

    def vary(self, card: ModelCard, asked: Json | None) -> ModelCard:
        if asked is None:
            return card
        raise InputError(
            "network", sorted(asked), "is not varied by the twin", "set BLADETWIN_SCIENCE=core"
        )

    def warm(self, card: ModelCard) -> None:
        """Nothing is compiled here."""

    def check_families(self, card: ModelCard, families: Sequence[Json]) -> None:
        from service.effects import read_families

        names = [parameter.name for parameter in card.network.parameters]
        read_families(families, names, list(card.outputs))

    def diagnose(
        self,
        card: ModelCard,
        rotor: RotorSpec,
        facts: Sequence[BladeRecord],
        readings: Sequence[Inspection],
        families: Sequence[Json],
        compare_h: float | None,
        progress: Progress,
    ) -> Json:
        """Chi-square of the residuals of each blade's line, n - 1 degrees of freedom each."""
        chi2, freedom = 0.0, 0
        for done, blade in enumerate(rotor.blades):
            progress(f"blade {blade}", done, len(rotor.blades))
            time.sleep(self.delay_s)
            own = [r for r in readings if (r.blade, r.quantity) == (blade, "elongation")]
            h = np.array([r.time_h / HORIZON_H for r in own])
            y = np.array([float(r.values[0]) for r in own])
            w = np.array([1.0 / (r.sigma or SIGMA) ** 2 for r in own])
            n, s = float(w @ h**2), float(w @ (h * y))
            if len(own) > 1 and n > 0:
                chi2 += float(w @ (y - s / n * h) ** 2)
                freedom += len(own) - 1
        p = float(chdtrc(freedom, chi2)) if freedom else 1.0
        why = f"chi-square {chi2:.1f} of {freedom} degrees of freedom: p = {p:.3g}"
        return {
            "verdict": "adequate" if p > ALARM else "unattributed",
            "names": [],
            "reasons": [why],
            "p": p,
            "p_after": None,
            "effects": [],
            "claimed": False,
            "gained_nat": 0.0,
            "evidence": {},
            "calibrated": [],
            "no_room": [],
            "tried": [],
            "holds": [],
            "parameters": {"before": {}, "after": {}},
            "readings": {"delivered": len(readings), "used": len(readings)},
            "models": {"before": card.digest, "after": card.digest},
            "before_after": None,
            "adds": None,
        }

    def plan(
        self,
        card: ModelCard,
        meta: Mapping[str, Any],
        get: Get,
        blades: Sequence[BladeRecord],
        readings: Sequence[Inspection],
        target: PlanTarget,
        count: int,
    ) -> Json:
        """Each blade's elongation at its latest hour, singly, by exact conditioning."""
        latest = {b.id: HORIZON_H / 2 for b in blades}
        latest |= {r.blade: r.time_h for r in sorted(readings, key=lambda r: r.time_h)}
        own = {b.id: self.moments(get, b.id) for b in blades}
        aim = np.ones(2) if target.parameter is None else np.array([1.0, 0.0])
        if target.parameter == "offset":
            aim = np.array([0.0, 1.0])
        hour = 1.0 if target.time_h is None else target.time_h / HORIZON_H
        mean, covariance = own[target.blade or blades[0].id]
        variance = float(aim @ covariance @ aim) * hour**2
        single = []
        for b in blades:
            h = max(latest[b.id], 1.0) / HORIZON_H
            of_blade = own[b.id][1]
            seen = float(of_blade.sum()) * h**2 + SIGMA**2
            if b.id == target.blade:
                shared = float(aim @ covariance @ np.ones(2))
            else:
                shared = float((aim @ covariance)[0] * of_blade[0].sum() / covariance[0, 0])
            left = float(np.sqrt(max(variance - (shared * hour * h) ** 2 / seen, 0.0)))
            told = {"blade": b.id, "quantity": "elongation", "time_h": h * HORIZON_H}
            told |= {"ahead_h": 0.0, "instrument": None, "sigma": None, "sd_after": left}
            single.append(told | {"narrower": 1 - left / variance**0.5 if variance else 0.0})
        single.sort(key=lambda one: (one["sd_after"], one["blade"]))
        centre = float(aim @ mean) * hour
        return {
            "unit": "mm",
            "mean": centre,
            "sd": variance**0.5,
            "single": single,
            "set": single[:1],
        }

    def residuals(
        self,
        card: ModelCard,
        rotor: RotorSpec,
        facts: Sequence[BladeRecord],
        readings: Sequence[Inspection],
        progress: Progress,
    ) -> Json:
        """Elongations of each hour, predicted exactly from those of the hours before."""
        from core.diagnosis.grammar import Facts
        from core.diagnosis.residuals import visits_of
        from service.residuals import exact_visit, told

        own = [r for r in readings if r.quantity == "elongation"]
        if not own:
            raise InputError("readings", 0, "of elongation count", "post inspections")
        lots = {b.id: Facts(b.lot, b.coating_lot) for b in facts}
        visits, before, found = visits_of(own, lots), list[Inspection](), []
        for number, visit in enumerate(visits):
            progress(f"visit {number + 1}", number, len(visits))
            state = self.update(card, rotor, before, None, quick=False)
            h = np.array([r.time_h / HORIZON_H for r in visit])
            one = [self.moments(state.arrays.__getitem__, r.blade) for r in visit]
            variance = state.arrays["shared/moments"][1]
            lean = np.array([1.0 + covariance[0, 1] / variance for _, covariance in one])
            signal = variance * np.outer(h * lean, h * lean)
            for i, r in enumerate(visit):
                for j, other in enumerate(visit):
                    if r.blade == other.blade:
                        signal[i, j] = one[i][1].sum() * h[i] * h[j]
            mean = np.array([m.sum() for m, _ in one]) * h
            noise = np.array([r.sigma or SIGMA for r in visit])
            found.append(exact_visit(visit, number, mean, signal, noise, rotor.seed))
            before += visit
        return told(found, lots, rotor.seed)

    def update(
        self,
        card: ModelCard,
        rotor: RotorSpec,
        readings: Sequence[Inspection],
        previous: Any,
        *,
        quick: bool,
    ) -> FakeState:
        time.sleep(self.delay_s)
        columns = {blade: np.zeros(2) for blade in rotor.blades}
        for reading in readings:
            h = self._sensitivity(reading, card)
            precision = 1.0 / (reading.sigma or SIGMA) ** 2
            y = reading.values[:, -1] if reading.values.ndim == 2 else reading.values
            columns[reading.blade] += [precision * float(h @ h), precision * float(h @ y)]
        precision, weighted = 1.0 / SD**2, MEAN / SD**2
        for n, s in columns.values():
            if n > 0:
                precision += 1.0 / (1.0 / n + SCATTER**2)
                weighted += (s / n) / (1.0 / n + SCATTER**2)
        arrays: dict[str, Array] = {f"column/{name}": column for name, column in columns.items()}
        arrays["shared/moments"] = np.array([weighted / precision, 1.0 / precision])
        exact = {"status": "ok", "reasons": [], "met_floor": True, "contradicted": []}
        meta = {
            "algorithm_version": "fake-1",
            "events_digest": digest_of(readings),
            "sealed": not (quick and self.provisional),
            "health": {"ess": rotor.particles, "ess_ratio": 1.0} | exact,
            "blades": list(rotor.blades),
            "particles": rotor.particles,
            "seed": rotor.seed,
            "readings": len(readings),
        }
        return FakeState(meta, arrays)

    @staticmethod
    def _sensitivity(reading: Inspection, card: ModelCard) -> NDArray[np.float64]:
        h = reading.time_h / HORIZON_H
        if reading.quantity == "elongation":
            return np.array([h])
        nodes = np.array([3]) if reading.nodes is None else reading.nodes
        scale = 1.0 if reading.quantity == "deformation" else 0.01
        return np.asarray(scale * h * (nodes + 1) / card.node_count)

    def restore(self, meta: Mapping[str, Any], get: Get) -> FakeState:
        names = [f"column/{blade}" for blade in meta["blades"]] + ["shared/moments"]
        return FakeState(meta, {name: get(name) for name in names})

    @staticmethod
    def moments(get: Get, blade: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mean (2,) and covariance (2, 2) of (m, l_b) given everything."""
        (mean, variance), (n, s) = get("shared/moments"), get(f"column/{blade}")
        gain = n * SCATTER**2 / (1.0 + n * SCATTER**2)
        rate = s / n if n > 0 else 0.0
        local_variance = SCATTER**2 * (1.0 - gain)
        centre = np.array([mean, gain * (rate - mean)])
        cross = -gain * variance
        covariance = [[variance, cross], [cross, local_variance + gain**2 * variance]]
        return centre, np.array(covariance)

    def shared_draws(self, meta: Mapping[str, Any], get: Get) -> Draws:
        mean, variance = get("shared/moments")
        z = stream(meta["seed"], "shared").standard_normal((meta["particles"], 1))
        return Draws(("rate",), mean + np.sqrt(variance) * z, np.zeros(len(z)))

    def blade_draws(self, meta: Mapping[str, Any], get: Get, blade: str) -> Draws:
        mean, covariance = self.moments(get, blade)
        z = stream(meta["seed"], "blade", blade).standard_normal((meta["particles"], 2))
        root = np.linalg.cholesky(covariance + 1e-15 * np.eye(2))
        return Draws(("rate", "offset"), mean + z @ root.T, np.zeros(len(z)))

    def joint_draws(
        self, meta: Mapping[str, Any], get: Get, blades: Sequence[str], count: int
    ) -> JointDraws:
        """m first, then each l_b given m."""
        rng = stream(meta["seed"], "joint")
        centre, variance = get("shared/moments")
        shared = centre + np.sqrt(variance) * rng.standard_normal((count, 1))
        local = np.empty((count, len(blades), 1))
        for i, blade in enumerate(blades):
            mean, covariance = self.moments(get, blade)
            slope = covariance[1, 0] / variance
            left = np.sqrt(covariance[1, 1] - slope**2 * variance)
            local[:, i] = mean[1] + slope * (shared - centre)
            local[:, i] += left * rng.standard_normal((count, 1))
        return JointDraws(("rate",), shared, ("offset",), tuple(blades), local, meta["particles"])

    def prior_draws(self, card: ModelCard, like: JointDraws) -> JointDraws:
        from service.predictive import prior_draws

        shared = {name: card.network.parameter(name).prior for name in like.shared_names}
        return prior_draws(card.network, shared, like)

    def replicated(
        self,
        card: ModelCard,
        drawn: JointDraws,
        readings: Sequence[Inspection],
        known: Mapping[str, Mapping[str, float]],
    ) -> list[NDArray[np.float64]]:
        """(m + l_b) h at the reading's nodes, with its noise."""
        found = []
        for one in readings:
            rate = drawn.shared[:, 0] + drawn.local[:, drawn.blades.index(one.blade), 0]
            nodes = [None] if one.nodes is None else one.nodes.tolist()
            scale = np.concatenate([along(card, one.quantity, node) for node in nodes])
            y = np.outer(rate, scale * one.time_h / HORIZON_H)
            z = stream(0, "replicated", one.id).standard_normal(y.shape)
            found.append(y + (one.sigma or SIGMA) * z)
        return found

    def forward(
        self, card: ModelCard, quantity: str, blade: str | None, known: Mapping[str, float] | None
    ) -> Forward:
        return FakeForward(card, quantity)

    def mesh(self, card: ModelCard) -> Mesh:
        """The strip's triangles."""
        strip = self.surface(card)
        return Mesh(strip.points, strip.triangles, "triangle")

    def surface(self, card: ModelCard) -> Surface:
        """A strip of two columns of nodes, from root to tip."""
        rows = card.node_count // 2
        number = np.arange(2 * rows).reshape(rows, 2)
        points = np.zeros((card.node_count, 3))
        points[: 2 * rows, 0], points[: 2 * rows, 2] = np.tile([0.0, 10.0], rows), number.ravel()
        a, b = number[:-1].T, number[1:].T
        pairs = [(a[0], a[1], b[0]), (a[1], b[1], b[0])]
        return Surface(points, np.concatenate([np.stack(one, axis=1) for one in pairs]))

    def field(
        self,
        card: ModelCard,
        meta: Mapping[str, Any],
        get: Get,
        blade: str,
        quantity: str,
        time_h: float,
        *,
        known: Mapping[str, float] | None,
    ) -> Field:
        mean, covariance = self.moments(get, blade)
        along = time_h / HORIZON_H * (np.arange(card.node_count) + 1) / card.node_count
        along = along[:, None] * [0.0, 0.0, 1.0] if quantity == "deformation" else 0.01 * along
        return Field(mean.sum() * along, np.sqrt(covariance.sum()) * along, meta["particles"])

    def predict(
        self,
        card: ModelCard,
        meta: Mapping[str, Any],
        get: Get,
        blade: str,
        quantity: str,
        times: Sequence[float],
        node: int | None,
        probability: float,
        *,
        instrument: str | None,
        known: Mapping[str, float] | None,
    ) -> FakePrediction:
        mean, covariance = self.moments(get, blade)
        time_h = np.asarray(times, float)
        h = time_h[:, None] / HORIZON_H * along(card, quantity, node)
        h = h if quantity == "deformation" else h[:, 0]
        parameters = np.sqrt(covariance.sum()) * h
        zero, noise = np.zeros_like(h), np.full_like(h, SIGMA)
        total = np.hypot(parameters, noise)
        centre = mean.sum() * h
        half = ndtri(0.5 + probability / 2) * total
        parts = {"parameters": parameters, "surrogate": zero, "discrepancy": zero}
        return FakePrediction(
            time_h,
            centre,
            parts | {"noise": noise, "total": total},
            centre - half,
            centre + half,
            {level: centre + ndtri(level) * total for level in LEVELS},
        )
