from __future__ import annotations

from dataclasses import FrozenInstanceError, fields, replace
from pathlib import Path

import pytest

from core.blade import properties as module
from core.blade.properties import Creep, Geometry, Material, Properties, Service
from core.errors import RangeError


def test_every_value_names_its_unit_and_every_group_its_source() -> None:
    text = Path(module.__file__).read_text(encoding="utf-8")
    lines = {line.split(":")[0].strip(): line for line in text.splitlines() if " = " in line}
    for group in (Material, Creep, Geometry, Service):
        for f in fields(group):
            assert "#" in lines[f.name], f.name
    for word in ("[A]", "[B]", "[C]", "assumed", "from memory"):
        assert word in text


def test_properties_are_replaced_and_never_changed() -> None:
    p = Properties()
    with pytest.raises(FrozenInstanceError):
        p.creep.monkman_grant = 0.03  # type: ignore[misc]
    assert replace(p, creep=replace(p.creep, monkman_grant=0.03)).creep.monkman_grant == 0.03


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -1.0, 0.0])
def test_an_impossible_value_is_refused_by_its_full_name(bad: float) -> None:
    p = Properties()
    with pytest.raises(RangeError) as caught:
        replace(p, geometry=replace(p.geometry, span=bad))
    assert caught.value.what == "properties.geometry.span"


def test_a_damaged_table_is_refused() -> None:
    p = Properties()
    with pytest.raises(RangeError, match=r"material\.youngs_modulus"):
        replace(p, material=replace(p.material, youngs_modulus=(201e3, -178e3, 155e3, 130e3)))
    with pytest.raises(RangeError, match="the 4 values of temperature_k"):
        replace(p, material=replace(p.material, conductivity=(0.0115, 0.0175, 0.0228)))
    with pytest.raises(RangeError, match="does not increase"):
        replace(p, material=replace(p.material, temperature_k=(293.0, 700.0, 700.0, 1300.0)))


@pytest.mark.parametrize("bad", [0.5, 0.7])
def test_a_blade_that_cannot_be_compressed_is_refused(bad: float) -> None:
    """At 0.5 the elements divide by nothing, above it they are softer the harder they are."""
    p = Properties()
    with pytest.raises(RangeError, match=r"poisson_ratio.*0\.25 … 0\.4"):
        replace(p, material=replace(p.material, poisson_ratio=bad))
    assert replace(p, material=replace(p.material, poisson_ratio=0.49)).material.poisson_ratio
