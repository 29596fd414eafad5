"""Fields of the real model at nodes, and the surface of its mesh."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from core.blade.geometry import build_mesh
from core.calibration.state import Posterior
from core.diagnosis.adopt import with_effects
from core.diagnosis.families import FAMILIES
from core.diagnosis.grammar import Cell
from core.model import Model, rotor_blade, rotor_blade_wide
from core.prediction import predict
from core.smc.particles import Particles
from core.surrogate.driven import Driven
from service.fields import ENOUGH, field_of, skin, surface_of
from service.science import CoreScience


@pytest.fixture(scope="module")
def model() -> Model:
    return rotor_blade()


def posterior(n: int) -> Posterior:
    """Weighted particles around the middle of the priors, the same for every n."""
    rng = np.random.default_rng(3)
    names = ("tbc_thickness", "creep_transient", "creep_steady", "t1t_rate")
    psi = np.column_stack(
        [rng.normal(1.0, 0.05, n), *rng.normal(0, 0.3, (2, n)), rng.normal(0.9, 0.01, n)]
    )
    return Posterior(names, Particles(psi, rng.normal(0, 0.5, n)))


@pytest.mark.parametrize(("quantity", "component"), [("ceeq", None), ("deformation", 2)])
def test_a_field_has_the_prediction_s_mean_and_sd_without_noise(
    model: Model, quantity: str, component: int | None
) -> None:
    """With no more particles than ENOUGH both are the same sums."""
    own = posterior(300)
    found = field_of(model, own, quantity, 30_000.0, None)
    mean, sd = (found.mean, found.sd) if component is None else (found.mean[:, 2], found.sd[:, 2])
    for node in (1217, 2840, 5440):
        told = predict(model, own, quantity, [30_000.0], node, component=component, noise=False)
        assert mean[node] == pytest.approx(told.mean[0], rel=1e-9)
        assert sd[node] == pytest.approx(told.sd["total"][0], rel=1e-6)
        assert sd[node] != pytest.approx(told.sd["parameters"][0], rel=1e-5), "negative control"


def test_a_drawn_field_is_as_near_as_it_says(model: Model) -> None:
    own = posterior(4000)
    found = field_of(model, own, "ceeq", 30_000.0, None)
    told = predict(model, own, "ceeq", [30_000.0], 2840, noise=False)
    assert found.particles == ENOUGH
    assert abs(found.mean[2840] - told.mean[0]) < 0.1 * told.sd["total"][0]
    assert found.sd[2840] == pytest.approx(told.sd["total"][0], rel=0.12)


@pytest.fixture(scope="module")
def worn() -> tuple[Model, Posterior]:
    """The wide model with a coating that wears, and a posterior of it."""
    wide = rotor_blade_wide()
    wear = next(one for one in FAMILIES if one.name == "coating wear")
    cell = Cell(wear, "linear", "all")
    model = with_effects(wide, [cell], {}, {"elongation": 0.02}, {"B1": 24_000.0})
    told = posterior(ENOUGH)
    rng = np.random.default_rng(5)
    psi = np.column_stack([told.particles.psi, rng.normal(0.2, 0.02, ENOUGH)])
    psi[:, 0] = np.maximum(psi[:, 0], 1.0)
    return model, Posterior((*told.names, cell.name), Particles(psi, told.particles.log_w))


@pytest.mark.parametrize("quantity", ["deformation", "ceeq"])
def test_a_field_under_inputs_that_run_is_told_by_some_particles(
    worn: tuple[Model, Posterior], quantity: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    model, own = worn
    nodes, asked = [1217, 2840, 5440], []
    in_blocks = Driven.in_blocks

    def counted(self: Driven, x: NDArray[np.float64], *a: Any, **k: Any) -> Any:
        asked.append(len(x))
        return in_blocks(self, x, *a, **k)

    monkeypatch.setattr(Driven, "in_blocks", counted)
    found = field_of(model, own, quantity, 50_000.0, None, nodes)
    some = sum(asked)
    monkeypatch.setattr("core.surrogate.nearby.SHARE", 0.0)
    each = field_of(model, own, quantity, 50_000.0, None, nodes)
    assert some <= ENOUGH / 4
    assert sum(asked) == some + ENOUGH
    assert np.all(np.abs(found.mean - each.mean) <= 0.05 * each.sd)
    assert found.sd == pytest.approx(each.sd, rel=0.05)
    assert not np.array_equal(found.mean, each.mean), "negative control: they are not the same sums"


def volume(points: NDArray[np.float64], triangles: NDArray[np.int64]) -> float:
    """Volume inside a closed surface whose triangles run counter-clockwise from outside."""
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def is_closed(triangles: NDArray[np.int64]) -> bool:
    """Every edge is run through once each way."""
    edges = Counter(map(tuple, np.concatenate([triangles[:, [i, (i + 1) % 3]] for i in range(3)])))
    return all(n == 1 and edges[(b, a)] == 1 for (a, b), n in edges.items())


def test_the_surface_is_closed_faces_outward_and_holds_the_metal() -> None:
    mesh = build_mesh("coarse")
    surface = skin(mesh.points, mesh.cells)
    assert is_closed(surface.triangles)
    assert volume(surface.points, surface.triangles) == pytest.approx(mesh.volume, rel=0.01)
    assert not is_closed(surface.triangles[1:]), "negative control: a hole"
    turned = surface.triangles.copy()
    turned[0] = turned[0, ::-1]
    assert not is_closed(turned), "negative control: a triangle that faces inward"


def test_a_model_without_the_blade_s_mesh_has_no_surface() -> None:
    science = CoreScience()
    blade = science.surface(science.builtin("rotor-blade"))
    assert blade is not None
    assert blade.triangles.max() < len(blade.points) == 5600
    assert science.surface(science.builtin("creep-specimens")) is None
    moved = build_mesh("coarse").points + 1.0
    assert surface_of(moved, "coarse") is None, "another shape than the mesh of that name"
