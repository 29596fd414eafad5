from __future__ import annotations

import json
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from core.errors import ModelError
from core.surrogate import Surrogate, load, save

X = np.array([[0.81, 0.93, 1.3, -0.7]])


@pytest.fixture
def saved(model: Surrogate, tmp_path: Path) -> Path:
    save(replace(model, manifest={"name": "stand-in", "seed": 11}), tmp_path)
    return tmp_path


def test_what_is_loaded_predicts_bit_for_bit_what_was_saved(model: Surrogate, saved: Path) -> None:
    back = load(saved)
    for quantity in model.quantities:
        for a, b in zip(
            model.predict(X, quantity, [0.5, 777.0, 50_000.0]),
            back.predict(X, quantity, [0.5, 777.0, 50_000.0]),
            strict=True,
        ):
            np.testing.assert_array_equal(a, b)
    assert back.inputs == model.inputs
    assert back.quantities == model.quantities
    assert back.named == model.named
    assert back.horizon_h == 50_000.0
    np.testing.assert_array_equal(back.points, model.points)


def test_the_manifest_keeps_its_notes_and_names_schema_and_digest(
    model: Surrogate, saved: Path
) -> None:
    manifest = load(saved).manifest
    assert manifest["name"] == "stand-in"
    assert manifest["seed"] == 11
    powers = {part.power for part in model.parts.values()}
    assert manifest["schema"] == 1 + (powers != {1.0})
    assert manifest["digest"] == load(saved).digest
    assert len(manifest["digest"]) == 64


def test_the_digest_is_of_the_content_and_not_of_the_notes(
    model: Surrogate, saved: Path, tmp_path: Path
) -> None:
    first = load(saved).digest
    assert save(replace(model, manifest={"other": 1}), tmp_path / "b").digest == first
    changed = save(replace(model, v_typical=model.v_typical * 1.5), tmp_path / "c")
    assert changed.digest != first


def flipped(saved: Path, place: int) -> Exception | None:
    """What loading says of a manifest with one byte changed."""
    whole = (saved / "manifest.json").read_bytes()
    spoilt = whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :]
    (saved / "manifest.json").write_bytes(spoilt)
    try:
        load(saved)
    except ModelError as error:
        return error
    finally:
        (saved / "manifest.json").write_bytes(whole)
    return None


def test_any_byte_of_the_manifest_that_is_changed_is_found(model: Surrogate, saved: Path) -> None:
    """Of the notes, of their names and of the digests; the structure is the other digest's."""
    text = (saved / "manifest.json").read_text()
    told = load(saved).manifest
    assert "whole" not in told
    for place in range(text.index('"structure"')):
        assert flipped(saved, place) is not None, text[place - 20 : place + 20]
    assert "note" in str(flipped(saved, text.index("stand-in")))
    assert "note" in str(flipped(saved, text.index('"whole"') + 1)), "its name is lost"


def test_a_manifest_from_before_and_one_in_another_order_are_read(saved: Path) -> None:
    manifest = json.loads((saved / "manifest.json").read_text())
    turned = dict(reversed(manifest.items()))
    (saved / "manifest.json").write_text(json.dumps(turned))
    assert load(saved).manifest["name"] == "stand-in"
    del manifest["whole"]
    (saved / "manifest.json").write_text(json.dumps(manifest | {"name": "stand-on"}))
    assert load(saved).manifest["name"] == "stand-on"
    with pytest.raises(ModelError, match="this release says 000000"):
        load(saved, whole="0" * 64)


def test_loaded_arrays_cannot_be_written(saved: Path) -> None:
    with pytest.raises(ValueError, match="read-only"):
        load(saved).points[0, 0] = 1.0


def rewrite(path: Path, change: dict[str, np.ndarray], *, pickled: bool = False) -> None:
    with np.load(path / "arrays.npz") as stored:
        arrays = {name: stored[name] for name in stored.files}
    with open(path / "arrays.npz", "wb") as handle:
        np.savez(handle, allow_pickle=pickled, **(arrays | change))


def test_one_changed_number_is_found(saved: Path) -> None:
    with np.load(saved / "arrays.npz") as stored:
        weights = stored["process/weights"]
    weights[3, 2] = np.nextafter(weights[3, 2], np.inf)
    rewrite(saved, {"process/weights": weights})
    with pytest.raises(ModelError, match="is damaged"):
        load(saved)


def test_a_manifest_that_tells_another_structure_is_found(saved: Path) -> None:
    manifest = json.loads((saved / "manifest.json").read_text())
    manifest["structure"]["inputs"][1]["high"] = 1.1
    (saved / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(ModelError, match="is damaged"):
        load(saved)


def test_objects_are_never_unpickled(saved: Path) -> None:
    rewrite(saved, {"time_h": np.array([{"a": 1}], dtype=object)}, pickled=True)
    with pytest.raises(ModelError, match="allow_pickle"):
        load(saved)


def test_another_schema_a_cut_file_and_an_empty_folder_are_refused(
    saved: Path, tmp_path: Path
) -> None:
    whole = (saved / "arrays.npz").read_bytes()
    (saved / "arrays.npz").write_bytes(whole[:-500])
    with pytest.raises(ModelError, match="no readable arrays"):
        load(saved)
    manifest = json.loads((saved / "manifest.json").read_text())
    (saved / "manifest.json").write_text(json.dumps(manifest | {"schema": 3}))
    with pytest.raises(ModelError, match="schema is neither 1 nor 2"):
        load(saved)
    with pytest.raises(ModelError, match="no readable manifest"):
        load(tmp_path / "nothing")


def test_a_second_save_writes_the_same_bytes(model: Surrogate, saved: Path, tmp_path: Path) -> None:
    save(replace(model, manifest={"name": "stand-in", "seed": 11}), tmp_path / "b")
    for name in ("arrays.npz", "manifest.json"):
        assert (saved / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    assert zipfile.is_zipfile(saved / "arrays.npz")


def test_the_scale_of_a_parts_clock_is_kept_and_one_hour_is_not_told(
    model: Surrogate, saved: Path, tmp_path: Path
) -> None:
    manifest = json.loads((saved / "manifest.json").read_text())
    assert not any("early_h" in part for part in manifest["structure"]["parts"].values())
    parts = {
        name: replace(part, factors=replace(part.factors, early_h=500.0))
        for name, part in model.parts.items()
    }
    other = save(replace(model, parts=parts), tmp_path / "late")
    assert other.digest != load(saved).digest
    back = load(tmp_path / "late")
    assert {part.factors.early_h for part in back.parts.values()} == {500.0}


def test_powers_of_errors_are_kept_and_tell_releases_without_them_to_stay_away(
    model: Surrogate, tmp_path: Path
) -> None:
    plain = {name: replace(part, power=1.0) for name, part in model.parts.items()}
    powered = plain | {"ceeq": replace(plain["ceeq"], power=0.6)}
    digests = set()
    for parts, schema in ((plain, 1), (powered, 2)):
        digests.add(save(replace(model, parts=parts), tmp_path / str(schema)).digest)
        manifest = json.loads((tmp_path / str(schema) / "manifest.json").read_text())
        assert manifest["schema"] == schema
        told = {n for n, one in manifest["structure"]["parts"].items() if "power" in one}
        assert told == ({"ceeq"} if schema == 2 else set())
        back = load(tmp_path / str(schema))
        assert {n: part.power for n, part in back.parts.items()} == {
            n: part.power for n, part in parts.items()
        }
    assert len(digests) == 2
