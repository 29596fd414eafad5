"""Pictures of answers: what is drawn is what was told, with names and units, and nothing overlaps.

The twin's numbers are exact, so that places of artists are compared with the answers'.
"""

from __future__ import annotations

import io
import re
import time
from collections.abc import Iterator
from typing import Any

import matplotlib
import matplotlib.image
import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from service.client import plots
from service.testing import InMemory, in_memory

Json = dict[str, Any]
NAMES = [f"B{i:02d}" for i in range(1, 17)]
HOURS = [0.0, 8000.0, 24_000.0, 5e4]
CAMPAIGNS = ((1, 8000), (2, 16_000), (3, 24_000))


def readings() -> str:
    """Each blade at each campaign; of the third those of B03 and B04 are far off."""
    rows = ["id,blade,quantity,time_h,value,sigma,campaign"]
    for number, hour in CAMPAIGNS:
        for i, blade in enumerate(NAMES):
            off = 0.2 if number == 3 and blade in ("B03", "B04") else 0.0
            value = (0.3 + 0.02 * i) * hour / 5e4 + off
            rows.append(f"{blade}-{number},{blade},elongation,{hour},{value:.4f},0.01,c{number}")
    rows += ["late,B01,elongation,9000,0.06,0.02,c4", "wrong,B01,elongation,26000,2.0,0.02,c4"]
    return "\n".join(rows) + "\n"


@pytest.fixture(scope="module")
def twin() -> Iterator[InMemory]:
    matplotlib.use("Agg")
    with in_memory() as twin:
        slotted = [{"id": b, "slot": str(len(NAMES) - i)} for i, b in enumerate(NAMES)]
        twin.create_rotor("r1", blades=slotted)
        twin.post_csv("r1", readings())
        again = {"id": "again", "blade": "B01", "quantity": "elongation", "time_h": 16_100.0}
        twin.post_inspections("r1", [again | {"value": 0.1, "replaces": "B01-2"}])
        strain = {"id": "strain", "blade": "B01", "quantity": "ceeq", "time_h": 9000.0}
        twin.post_inspections("r1", [strain | {"nodes": [6000], "values": [0.0005]}])
        twin.retire_blade("r1", "B16")
        twin.wait_for("r1", twin.retract("r1", "wrong"))
        twin.wait_sealed("r1")
        yield twin


@pytest.fixture(autouse=True)
def closed() -> Iterator[None]:
    yield
    pyplot.close("all")


def labels(axes: Axes) -> list[str]:
    return axes.get_legend_handles_labels()[1]


def picture(figure: Any) -> np.ndarray[Any, Any]:
    """The figure as it is saved, (height, width, 4)."""
    assert isinstance(figure, Figure)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=100)
    buffer.seek(0)
    return matplotlib.image.imread(buffer)


def texts(axes: Axes) -> Iterator[Any]:
    """Titles, labels, the ticks' own and those of the legend."""
    for axis in (axes.xaxis, axes.yaxis):
        low, high = sorted(axis.get_view_interval())
        places = zip(axis.get_ticklocs(), axis.get_ticklabels(), strict=True)
        yield from (text for place, text in places if low <= place <= high)
        yield axis.label
    yield from axes.texts
    yield axes._left_title  # type: ignore[attr-defined]
    legend = axes.get_legend()
    yield from () if legend is None else legend.get_texts()


def check_drawn(axes: Axes) -> None:
    """Something is drawn, at 640 pixels; texts lie inside and do not overlap one another."""
    seen = picture(axes.figure)
    assert seen.shape[1] == 640
    assert len(np.unique(seen.reshape(-1, 4), axis=0)) > 50
    figure = axes.figure
    assert isinstance(figure, Figure)
    frame = figure.bbox
    shown = [text for one in figure.axes for text in texts(one) if text.get_text()]
    boxes = [(text.get_text(), text.get_window_extent()) for text in shown]
    for i, (name, box) in enumerate(boxes):
        assert box.x0 > frame.x0 - 1, name
        assert box.x1 < frame.x1 + 1, name
        for other, beside in boxes[i + 1 :]:
            assert not box.padded(-1.5).overlaps(beside.padded(-1.5)), (name, other)


def test_a_band_is_that_of_the_answer_and_its_sources_add_up_to_it(twin: InMemory) -> None:
    told = twin.prediction("r1", "B01", "elongation", times=HOURS)
    axes = plots.band(told)
    assert axes.get_xlabel() == "operating hours [h]"
    assert axes.get_ylabel() == "elongation of B01 [mm]"
    assert "95 %" in axes.get_title(loc="left")
    assert labels(axes) == ["model parameters", "a reading's noise", "mean"]
    assert np.allclose(axes.lines[0].get_xydata(), np.column_stack([HOURS, told["mean"]]))
    assert len(axes.collections) == 4, "two sources, above and below; none of those that are 0"
    ends = np.vstack([one.get_paths()[0].vertices for one in axes.collections])
    for i, hour in enumerate(HOURS):
        at = ends[ends[:, 0] == hour, 1]
        assert at.max() == pytest.approx(told["upper"][i])
        assert at.min() == pytest.approx(told["lower"][i])
        assert np.isclose(at, told["mean"][i] + 1.959964 * told["sd"]["parameters"][i]).any()
    check_drawn(axes)


def test_readings_of_the_blade_have_marks_by_their_status(twin: InMemory) -> None:
    frame = twin.readings_frame("r1")
    axes = plots.band(twin.prediction_frame("r1", "B01"), frame, limit=0.5)
    drawn = {c.get_label(): c.lines[0].get_xydata().tolist() for c in axes.containers}  # type: ignore[attr-defined]
    assert sorted(drawn) == ["late readings ± sigma", "readings ± sigma", "replaced", "retracted"]
    assert [x for x, _ in drawn["readings ± sigma"]] == [8000.0, 24_000.0]
    assert sorted(drawn["late readings ± sigma"]) == [[9000.0, 0.06], [16_100.0, 0.1]]
    assert drawn["retracted"] == [[26_000.0, 2.0]]
    assert [x for x, _ in drawn["replaced"]] == [16_000.0]
    marks = {c.lines[0].get_marker() for c in axes.containers}  # type: ignore[attr-defined]
    assert len(marks) == 4
    assert "limit 0.5 mm" in labels(axes)
    check_drawn(axes)
    listed = plots.band(twin.prediction("r1", "B01"), twin.inspections("r1"))
    assert len(listed.containers) == 4, "answers do as well as frames"


def test_a_band_at_a_node_and_of_a_vector_says_so(twin: InMemory) -> None:
    listed = twin.readings_frame("r1")
    strain = plots.band(twin.prediction_frame("r1", "B01", "ceeq", node=6000), listed)
    assert strain.get_ylabel() == "ceeq of B01, node 6000 [1]"
    assert len(strain.containers) == 1
    elsewhere = plots.band(twin.prediction_frame("r1", "B01", "ceeq", node=7), listed)
    assert len(elsewhere.containers) == 0, "a reading at another node is none of it"
    told = twin.prediction("r1", "B01", "deformation", times=HOURS)
    vector = plots.band(told, listed, component="x")
    assert vector.get_ylabel() == "deformation of B01, x, node 6447 [mm]"
    assert vector.lines[0].get_ydata().tolist() == [row[0] for row in told["mean"]]  # type: ignore[union-attr]
    check_drawn(vector)


def test_a_state_that_is_not_to_be_trusted_is_drawn_with_the_warning(twin: InMemory) -> None:
    told = twin.prediction("r1", "B01")
    assert "trusted" not in plots.band(told).get_title(loc="left")
    told["health"] |= {"trusted": False, "status": "degenerate"}
    axes = plots.band(told)
    assert "not to be trusted: degenerate" in axes.get_title(loc="left")
    check_drawn(axes)


def test_each_parameter_has_a_row_with_its_intervals_and_unit(twin: InMemory) -> None:
    posterior = twin.posterior("r1", "B02")
    rows = plots.parameters(posterior, twin.model("rotor-blade"))
    assert [row.get_ylabel() for row in rows] == ["rate [mm]", "offset [mm]"]
    for row, told in zip(rows, posterior["parameters"].values(), strict=True):
        thin, thick = (one.get_segments()[0][:, 0].tolist() for one in row.collections[:2])  # type: ignore[attr-defined]
        assert thin == [told["quantiles"]["0.025"], told["quantiles"]["0.975"]]
        assert thick == [told["quantiles"]["0.16"], told["quantiles"]["0.84"]]
        assert row.lines[0].get_xdata() == [told["mean"]]
    check_drawn(rows[0])
    bare = plots.parameters(twin.posterior("r1"))
    assert [row.get_ylabel() for row in bare] == ["rate"]
    with pytest.raises(ValueError, match="1 axes for 2 parameters"):
        plots.parameters(posterior, axes=bare)


def test_residuals_are_told_apart_and_the_worst_of_many_groups_named(twin: InMemory) -> None:
    while (frame := twin.residuals_frame("r1")).attrs["pending"]:
        time.sleep(0.02)
    by_campaign = plots.residuals(frame)
    assert labels(by_campaign) == ["c1", "c2", "c3", "c4", "no campaign"]
    drawn = sum(len(line.get_xydata()) for line in by_campaign.lines[3:])
    assert drawn == len(frame)
    assert [line.get_ydata()[0] for line in by_campaign.lines[:3]] == [-2, 2, 0]  # type: ignore[index]
    check_drawn(by_campaign)
    by_blade = plots.residuals(frame, by="blade")
    assert labels(by_blade)[-1] == "9 others"
    assert {"B03", "B04"} < set(labels(by_blade)), "those that are far off"
    assert sum(len(line.get_xydata()) for line in by_blade.lines[3:]) == len(frame)
    check_drawn(by_blade)
    none = plots.residuals(twin.residuals_frame("r1", quantity="ceeq"))
    assert none.get_ylim() == (-3.0, 3.0)


def test_blades_stand_by_slot_with_those_past_the_limit_marked(twin: InMemory) -> None:
    frame = twin.blades_frame("r1", time_h=5e4)
    axes = plots.rotor(frame, limit=0.5)
    ticks = [text.get_text() for text in axes.get_xticklabels()]
    assert ticks[:2] == ["1: B16", "2: B15"]
    assert len(ticks) == 16
    assert "50,000 h" in axes.get_title(loc="left")
    assert axes.get_ylabel() == "elongation [mm]"
    places = {line.get_label(): np.asarray(line.get_xydata()) for line in axes.lines}
    past = places["mean past the limit"][:, 1]
    running = frame[~frame["retired"]]
    assert len(past) == (running["mean"] >= 0.5).sum() > 0
    assert past.min() >= 0.5 > places["mean"][:, 1].max()
    assert places["has left"][0].tolist() == [0, frame.loc["B16", "mean"]]
    thin, thick = axes.collections[:2]
    first = thick.get_segments()[1][:, 1]  # type: ignore[attr-defined]
    sd = frame.loc["B15", "sd_blade"]
    assert first[1] - first[0] == pytest.approx(2 * 1.959964 * sd)
    assert len(thin.get_segments()) == 16  # type: ignore[attr-defined]
    check_drawn(axes)
    vector = plots.rotor(twin.blades_frame("r1", quantity="deformation"))
    assert re.fullmatch(r"deformation z \[mm\]", vector.get_ylabel())


def test_many_blades_keep_their_names_apart() -> None:
    with in_memory(diagnosers=0) as twin:
        twin.create_rotor("r1", blades=[f"blade-{i:03d}" for i in range(90)])
        twin.wait_for("r1", 0)
        axes = plots.rotor(twin.blades_frame("r1"))
    assert len(axes.get_xticklabels()) == 23
    assert "every 4th" in axes.get_xlabel()
    check_drawn(axes)


def test_axes_that_are_given_are_drawn_into(twin: InMemory) -> None:
    figure, (left, right) = pyplot.subplots(1, 2)
    assert plots.band(twin.prediction("r1", "B01"), axes=left) is left
    assert plots.rotor(twin.blades_frame("r1"), axes=right) is right
    assert pyplot.get_fignums() == [figure.number]
