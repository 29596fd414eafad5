"""What a stored posterior tells, behind the `Science` port: draws, bands, life, fields.

A version of a rotor's posterior is its description (`meta`) and a function that gives its arrays by
name (`get`), so that a question about one blade loads what that blade needs and no more. Bands are
of core.prediction, the life to a limit of core.life, the end of the model's runs of core.runs_end;
a rotor's chances (core.rotor_life), joint and prior draws, the plain model and fields are imported
when they are first asked for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from core.calibration.state import Arrays, Posterior, RotorState, blade_posterior, shared_posterior
from core.life import Life, life
from core.observation import Inspection
from core.runs_end import courses_end, held_from
from service.bands import Bands, bands_of
from service.models import Models
from service.ports import (
    Array,
    BladeRecord,
    Draws,
    Field,
    Forward,
    Get,
    JointDraws,
    Mesh,
    ModelCard,
    RotorLife,
    Surface,
)


class Beliefs:
    """The part of the science that reads posteriors; none of it changes one.

    models   those that the posteriors rest on
    """

    def __init__(self, models: Models) -> None:
        self.models = models

    def restore(self, meta: Mapping[str, Any], get: Get) -> RotorState:
        return RotorState(meta, Arrays(meta["arrays"], {}, get))

    def shared_draws(self, meta: Mapping[str, Any], get: Get) -> Draws:
        return _draws(shared_posterior(meta, get))

    def blade_draws(self, meta: Mapping[str, Any], get: Get, blade: str) -> Draws:
        return _draws(blade_posterior(meta, get, blade), len(get("shared/log_w")))

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
    ) -> Bands:
        model, posterior = self.models.of(card).for_blade(blade), blade_posterior(meta, get, blade)
        return bands_of(
            model, posterior, quantity, times, node, probability, instrument=instrument, known=known
        )

    def life(
        self,
        card: ModelCard,
        meta: Mapping[str, Any],
        get: Get,
        blade: str,
        quantity: str,
        limit: float,
        times: Sequence[float],
        node: int | None,
        *,
        component: int | None,
        known: Mapping[str, float] | None,
    ) -> Life:
        model, posterior = self.models.of(card).for_blade(blade), blade_posterior(meta, get, blade)
        return life(
            model, posterior, quantity, limit, times, node, component=component, known=known
        )

    def rotor_life(
        self,
        card: ModelCard,
        meta: Mapping[str, Any],
        get: Get,
        blades: Sequence[BladeRecord],
        quantity: str,
        limit: float,
        times: Sequence[float],
        node: int | None,
        *,
        component: int | None,
        ages: Mapping[str, float] | None = None,
    ) -> RotorLife:
        from core.rotor_life import rotor_life

        return rotor_life(
            self.models.of(card),
            self.restore(meta, get),
            [blade.id for blade in blades],
            quantity,
            limit,
            times,
            node,
            component=component,
            known={blade.id: blade.known for blade in blades if blade.known is not None},
            ages=ages,
        )

    def held_from(
        self,
        card: ModelCard,
        meta: Mapping[str, Any],
        get: Get,
        blade: str,
        known: Mapping[str, float] | None,
    ) -> float | None:
        hours = [*courses_end(card.network, blade, card.horizon_h).values()]
        if any(d.held for d in card.network.drifts):
            posterior = blade_posterior(meta, get, blade)
            hours += held_from(self.models.of(card), posterior, blade, known).values()
        return min(hours, default=None)

    def joint_draws(
        self, meta: Mapping[str, Any], get: Get, blades: Sequence[str], count: int
    ) -> JointDraws:
        from service.joint import joint_draws

        return joint_draws(meta, get, blades, count)

    def prior_draws(self, card: ModelCard, like: JointDraws) -> JointDraws:
        from core.calibration.space import shared_prior
        from service.predictive import prior_draws

        model = self.models.of(card)
        shared = {name: shared_prior(model, name) for name in like.shared_names}
        return prior_draws(card.network, shared, like)

    def replicated(
        self,
        card: ModelCard,
        drawn: JointDraws,
        readings: Sequence[Inspection],
        known: Mapping[str, Mapping[str, float]],
    ) -> list[Array]:
        from service.predictive import replicated

        return replicated(self.models.of(card), drawn, readings, known)

    def forward(
        self, card: ModelCard, quantity: str, blade: str | None, known: Mapping[str, float] | None
    ) -> Forward:
        from service.forward import forward_of

        model = self.models.of(card)
        return forward_of(model if blade is None else model.for_blade(blade), quantity, known)

    def mesh(self, card: ModelCard) -> Mesh | None:
        from service.fields import mesh_of

        return mesh_of(self._points(card), card.summary.get("mesh"), self._of_runs(card, "cells"))

    def _points(self, card: ModelCard) -> Array | None:
        """The nodes of the training runs."""
        points: Array | None = self._of_runs(card, "points")
        return points

    def _of_runs(self, card: ModelCard, what: str) -> Any:
        """What the training runs had, also of a surrogate that effects drive; None: nothing."""
        surrogate = self.models.of(card).surrogate
        return getattr(getattr(surrogate, "base", surrogate), what, None)

    def surface(self, card: ModelCard) -> Surface | None:
        from service.fields import surface_of

        return surface_of(self._points(card), card.summary.get("mesh"))

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
        from service.fields import field_of

        model = self.models.of(card).for_blade(blade)
        return field_of(model, blade_posterior(meta, get, blade), quantity, time_h, known)


def _draws(posterior: Posterior, nodes: int | None = None) -> Draws:
    """With the shared node of each particle; nodes: how many, if not as many as particles."""
    own = posterior.particles
    each = len(own.log_w) // (nodes or len(own.log_w))
    return Draws(posterior.names, own.psi, own.log_w, np.arange(len(own.log_w)) // each)
