"""Truths of scanned fleets: the same blades as those whose elongation is read, seen in 3-D."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from core.blade import BOUNDS, build_mesh
from core.calibration.online import Workspace, update
from core.diagnosis.scoring import scores
from core.errors import InputError
from core.model import rotor_blade_wide
from core.validation import effect_fleet as fleet
from core.validation import effect_oracle as oracle
from core.validation import effect_scans as scans
from core.validation.effect_plans import NOISE, SCAN_NOISE, STRONGEST, Plan, plan
from core.validation.effect_sets import PHYSICS, made

SCANS, SECOND = plan("fleet-scans"), plan("fleet-scans-2")
LONG = plan("fleet-100")


@pytest.mark.parametrize(("rotor", "lengths"), [("first", SCANS), ("second", SECOND)])
def test_shapes_are_those_of_the_blades_whose_elongation_is_read(rotor: str, lengths: Plan) -> None:
    """Radial shift of the tip section's outer skin goes with the elongation of the same runs, a
    part of it (the blade bends and untwists as well); the control is another blade's."""
    kept = scans.load(rotor)
    assert np.array_equal(kept.nodes, scans.nodes()["default"])
    z = build_mesh("default").points[kept.nodes, 2]
    tip = np.flatnonzero(z == z.max())
    assert len(tip) == 16
    length = lengths.elongation[0]
    pairs = {"default": (kept.shape, length)}
    for effect in fleet.EFFECTS:
        pairs[effect] = kept.change[effect], length * (lengths.shares[effect][0] - 1.0)
    for what, (seen, own) in pairs.items():
        radial = seen[:, :3, tip, 2].mean(axis=2)
        told = [np.corrcoef(x.ravel(), own.ravel())[0, 1] for x in (radial, radial[::-1])]
        assert told[0] > 0.98 > 0.9 > told[1], what
        share = radial.sum() / own.sum()
        assert 0.4 < share < 0.9, what


@pytest.mark.parametrize("rotor", scans.FILES)
def test_a_run_is_what_ships(rotor: str) -> None:
    blade, kept = 3, scans.load(rotor)
    with_it, sound = scans.run(rotor, blade, "tertiary"), scans.run(rotor, blade, "sound")
    moved = (with_it - sound)[:, 1:].reshape(kept.change["tertiary"][blade].shape)
    assert moved == pytest.approx(kept.change["tertiary"][blade], abs=scans.UNIT)
    share = with_it[:, 0] / sound[:, 0]
    assert share == pytest.approx(kept.shares["tertiary"][blade], abs=1e-6)


def test_the_first_scanned_rotor_is_one_of_the_fleet_and_the_second_is_another() -> None:
    assert np.array_equal(SCANS.elongation[0], LONG.elongation[scans.ROTOR])
    assert np.array_equal(SCANS.shares["worn lot"][0], LONG.shares["worn lot"][scans.ROTOR])
    first, second = scans.design(), scans.design(scans.SECOND)
    assert not np.any(first == second)
    gas = second[:, list(BOUNDS).index("t1t_rate")]
    assert np.ptp(gas) == 0.0
    assert gas[0] == pytest.approx(0.94)
    for effect in PHYSICS:  # at two noises none is scaled far
        assert 0.3 < SECOND.strength(0, effect, 2.0) < STRONGEST
    with pytest.raises(InputError, match="third"):
        scans.shipped("third")


def test_a_campaign_that_is_not_at_its_end_is_no_file(tmp_path: Path) -> None:
    done = {name: np.zeros((4, 7)) for name in list(scans.runs())[:-1]}
    with pytest.raises(InputError, match="1 are missing"):
        scans.packed(done, tmp_path / "x.npz")
    assert not (tmp_path / "x.npz").exists()


def test_a_set_has_scans_of_some_blades_and_what_is_planted_is_in_them() -> None:
    clean = made(SCANS, "clean", 0, 5, 100)
    read = {r.quantity: [] for r in clean.case.readings}
    for r in clean.case.readings:
        read[r.quantity].append(r)
    assert [len(read[q]) for q in ("elongation", "deformation")] == [300, 80]
    assert len({r.blade for r in read["deformation"]}) == 40
    off = np.concatenate([(r.values - clean.exact[r.id]).ravel() for r in read["deformation"]])
    assert np.std(off) == pytest.approx(SCAN_NOISE, rel=0.03)
    assert len({r.campaign for r in read["deformation"]}) == 2
    for condition in (*PHYSICS, "campaign"):
        given = made(SCANS, condition, 0, 5, 100)
        moved = {
            r.blade
            for r in given.case.readings
            if r.quantity == "deformation" and np.any(given.exact[r.id] != given.sound[r.id])
        }
        lots = {given.case.facts[b].coating_lot for b in moved}
        expected = {"campaign": 0, "worn lot": 13}.get(condition, 40)
        assert len(moved) == expected, condition
        assert condition != "worn lot" or len(lots) == 1
    bursts = made(SCANS, "clean, bursts", 0, 5, 100)
    sound = {(r.blade, r.time_h): clean.exact[r.id] for r in read["deformation"]}
    ages = sorted(h for _, h in sound)
    wild = [r for r in bursts.case.readings if r.quantity == "deformation"]
    assert sorted(r.time_h for r in wild) == ages
    assert all(np.array_equal(bursts.exact[r.id], bursts.sound[r.id]) for r in wild)
    heavy = made(SCANS, "clean, heavy tails", 0, 5, 100)
    far = np.concatenate(
        [
            (r.values - heavy.exact[r.id]).ravel() / SCAN_NOISE
            for r in heavy.case.readings
            if r.quantity == "deformation"
        ]
    )
    assert np.mean(np.abs(far) > 4) > 5 * np.mean(np.abs(off / SCAN_NOISE) > 4) + 1e-3


def test_an_oracle_reads_scans_by_their_rows() -> None:
    """A change that is a pure mode's moves rows as the turn says; one off the modes moves none."""
    model, given = rotor_blade_wide(), made(SCANS, "clean", 0, 5, 200)
    some = sorted(given.case.spec.blades)[:4]
    data = tuple(r for r in given.case.readings if r.blade in some)
    spec = replace(given.case.spec, blades=tuple(some))
    work = Workspace()
    seen = scores(model, update(model, spec, data, workspace=work), data, None, work)
    scan = next(r for r in data if r.quantity == "deformation")
    assert scan.nodes is not None
    phi = model.part("deformation").deformation_modes(scan.nodes.tolist())
    q, _ = np.linalg.qr(phi.reshape(scan.values.size, -1))
    on = q[:, 2]
    off = np.random.default_rng(1).normal(size=scan.values.size)
    off -= q @ (q.T @ off)
    nothing = {r.id: np.zeros_like(r.values) for r in data}
    rows = {
        name: oracle.by_rows(model, seen, nothing | {scan.id: one.reshape(scan.values.shape)})
        for name, one in (("on", on), ("off", off))
    }
    b = seen.blades.index(scan.blade)
    place = seen.rows[b].readings.index(scan)
    own = seen.place[b] == place
    turn = seen.rows[b].mixings[place].turn
    assert rows["on"][b, own] == pytest.approx(turn[:, 2])
    assert np.count_nonzero(rows["on"]) == np.count_nonzero(turn[:, 2])
    assert np.abs(rows["off"]).max() < 1e-9
    length = next(r for r in data if r.quantity == "elongation")
    told = oracle.by_rows(model, seen, nothing | {length.id: np.array([NOISE])})
    assert np.sort(told.ravel())[-2:] == pytest.approx([0.0, NOISE])
