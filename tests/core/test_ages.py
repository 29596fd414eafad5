"""How old blades are: by campaigns, by their own readings, by the rotor."""

from __future__ import annotations

from core.ages import Age, ages
from core.observation import Inspection


def reading(blade: str, hour: float, campaign: str | None = None) -> Inspection:
    return Inspection(f"{blade}{hour}{campaign}", blade, "y", hour, [0.1], campaign=campaign)


def test_a_blade_that_was_not_read_lately_has_aged_with_the_rotor() -> None:
    """`late` joined at 12,000 h and was read once since; `left` is gone and told of the others."""
    data = [
        reading("left", 12_000, "c1"), reading("old", 12_000, "c1"),
        reading("old", 20_000, "c2"), reading("late", 8000, "c2"), reading("old", 30_000, "c3"),
    ]  # fmt: skip
    found = ages(["late", "old"], data)
    assert found == {"late": Age(18_000.0, "campaign"), "old": Age(30_000.0, "campaign")}
    assert ages(["late"], data[:-1]) == {"late": Age(8000.0, "campaign")}


def test_newest_is_the_rotor_s_newest_hour_and_not_the_largest_of_a_blade() -> None:
    data = [
        reading("old", 20_000, "c1"), reading("new", 2000, "c1"), reading("new", 9000),
    ]  # fmt: skip
    found = ages(["new", "old"], data)
    assert found == {"new": Age(9000.0, "campaign"), "old": Age(27_000.0, "campaign")}


def test_without_campaigns_a_blade_is_as_old_as_it_was_read() -> None:
    found = ages(["a", "b", "c"], [reading("a", 24_000), reading("a", 8000), reading("b", 16_000)])
    assert found == {
        "a": Age(24_000.0, "reading"),
        "b": Age(16_000.0, "reading"),
        "c": Age(24_000.0, "rotor"),
    }
    assert ages(["a"], []) == {"a": Age(0.0, "rotor")}


def test_a_campaign_of_no_single_day_tells_nothing() -> None:
    """A gauge's name at all visits, and an hour that was mistyped."""
    data = [reading("a", 8000, "gauge"), reading("a", 16_000, "gauge"), reading("b", 8000, "gauge")]
    assert ages(["a", "b"], data) == {"a": Age(16_000.0, "reading"), "b": Age(8000.0, "reading")}
