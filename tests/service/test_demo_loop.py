"""The main job's loop: what it adopts, and what it says before and after."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import pytest

from core.builtin import inspection_plan
from core.builtin.worn_plan import coating_lot
from service.demo import loop
from service.demo.loop_picture import draw_loop
from service.demo.result import Result

Json = dict[str, Any]
demo = importlib.import_module("service.demo.run")
BLADES = ("B001", "B040", "B041", "B099")


def result(off: float) -> Result:
    """Forecasts that are `off` mm too long on the worn lot, right elsewhere, ±0.1 mm."""
    held = {}
    for b in BLADES:
        mean = 1.0 + (off if coating_lot(b) == "C2" else 0.0)
        held[b] = (32_000.0, 1.0, mean, mean - 0.1, mean + 0.1, 0.05)
    local = {b: {"tbc_thickness": (1.0, 0.1, 1.05)} for b in BLADES}
    return Result({}, {"t1t_rate": (0.92, 0.003, 0.92)}, local, held, {})


def told(verdict: str) -> Json:
    claimed = verdict == "effect"
    effect = {
        "name": "coating wear (coating lot C2)",
        "amplitude": {"mean": 0.38, "sd": 0.05, "of": "lost of tbc_thickness by 50,000 h"},
    }
    return {
        "id": "d1",
        "rotor": "demo",
        "status": "done",
        "result": {
            "verdict": verdict,
            "claimed": claimed,
            "p": 0.002,
            "reasons": ["it gains 30 nat"],
            "effects": [effect] if claimed else [],
        },
    }


class Twin:
    """A service that answers a diagnosis at once; what was asked of it is kept."""

    def __init__(self, verdict: str) -> None:
        self.verdict, self.asked = verdict, list[str]()

    def diagnose(self, rotor: str) -> Json:
        self.asked.append("diagnose")
        return told(self.verdict)

    def adopt(self, rotor: str, diagnosis: str) -> None:
        self.asked.append(f"adopt {diagnosis}")

    def wait_sealed(self, rotor: str, patience_s: float) -> Json:
        self.asked.append("sealed")
        return {}


def closed(monkeypatch: pytest.MonkeyPatch, verdict: str) -> tuple[Twin, Result]:
    monkeypatch.setattr(loop, "collect", lambda *args, **more: result(0.01))
    twin = Twin(verdict)
    made = loop.closed(twin, None, result(-0.3), "demo", 1.0, quiet=True)  # type: ignore[arg-type]
    return twin, made


def test_what_is_claimed_is_adopted_and_both_forecasts_are_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    twin, made = closed(monkeypatch, "effect")
    assert twin.asked == ["diagnose", "adopt d1", "sealed"]
    assert made.loop is not None
    before, after = made.loop["before"], made.loop["after"]
    assert before["worn_lot_bias_mm"] == pytest.approx(-0.3)
    assert after["worn_lot_bias_mm"] == pytest.approx(0.01)
    assert (before["coverage_95"], after["coverage_95"]) == (0.5, 1.0)
    assert made.loop["adopted"] is True
    text = "\n".join(loop.lines(made.loop))
    assert "0.38 ± 0.05" in text
    assert "planted: 0.4 of the coating by 50,000 h" in text


def test_the_picture_shows_both_forecasts_by_lot_and_the_amplitude(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    _, made = closed(monkeypatch, "effect")
    assert made.loop is not None
    figure = draw_loop(made.loop, tmp_path / "loop.png")
    assert (tmp_path / "loop.png").read_bytes().startswith(b"\x89PNG")
    before, after, sizes = figure.axes

    def bias_of_lots(axis: Any) -> list[float]:
        return [round(float(c.get_segments()[0][0][1]), 6) for c in axis.collections[1::2]]

    assert bias_of_lots(before) == [0.0, -0.3, 0.0]
    assert bias_of_lots(after) == [0.0, 0.01, 0.0]
    assert "worn lot -300 µm" in before.get_xlabel()
    assert "planted: 0.4" in sizes.texts[0].get_text()
    assert float(sizes.lines[0].get_xdata()[0]) == pytest.approx(0.38 / 0.4)


@pytest.mark.parametrize("verdict", ["adequate", "not separable", "unattributed"])
def test_what_is_not_claimed_is_not_adopted(monkeypatch: pytest.MonkeyPatch, verdict: str) -> None:
    twin, made = closed(monkeypatch, verdict)
    assert twin.asked == ["diagnose"]
    assert made.loop is not None
    assert (made.loop["adopted"], made.loop["after"]) == (False, None)
    assert loop.lines(made.loop)[-1].strip() == "nothing was adopted"
    assert made.forecast_error == result(-0.3).forecast_error


def test_with_effects_only_elongations_are_streamed() -> None:
    plan = demo.elongations(inspection_plan.load())
    assert {body["quantity"] for body in plan.inspections} == {"elongation"}
    assert len(plan.inspections) > 290
    assert plan.held_out == inspection_plan.load().held_out
