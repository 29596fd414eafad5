"""A rotor leaves one database as a file and comes back in another, bit for bit."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable, Iterable
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import bindparam, func, select, text
from typer.testing import CliRunner

from core.errors import BladetwinError, InputError, RangeError
from core.observation import Inspection
from service import bundle
from service.bootstrap import make_worker
from service.bundle import BundleError
from service.cli import app as commands
from service.errors import ConflictError, DamagedLogError, DamagedRotorError, GoneError
from service.fake import FakeScience
from service.handlers import transfer_out
from service.handlers.blades import add_blade, retire_blade
from service.handlers.inspections import Item, post_inspections, retract
from service.handlers.listing import list_inspections
from service.handlers.models import register_builtins
from service.handlers.rotors import create_rotor, view_rotor
from service.handlers.transfer_in import import_rotor
from service.handlers.transfer_out import export_rotor
from service.ports import BladeRecord, Science, Which
from service.science import CoreScience
from service.settings import Settings
from service.store import records
from service.store import tables as t
from service.store.engine import transaction
from service.store.gathered import Gathered
from service.store.named import digests
from service.store.unit_of_work import SqlStore
from service.worker.replay import replay
from tests.service.smooth import formula_science

Make = Callable[..., Inspection]
Post = Callable[..., int]


def work(store: SqlStore, science: Science, settings: Settings) -> None:
    make_worker(store, science, settings, "w").drain()


def sealed(store: SqlStore, rotor: str) -> tuple[str, str, int, dict[str, str]]:
    """What a sealed state is called by: both digests, where it ends, SHA-256 of each array."""
    state = view_rotor(store, rotor).state
    assert state is not None
    assert state.sealed
    with store.read() as tx:
        names = digests(tx.connection, rotor)
    return state.digest, state.events_digest, state.through_seq, names


def log_of(store: SqlStore, rotor: str) -> list[tuple[Any, ...]]:
    query = select(t.entry).where(t.entry.c.rotor_id == rotor).order_by(t.entry.c.seq)
    with store.read() as tx:
        return [tuple(row)[1:] for row in tx.connection.execute(query)]


@pytest.fixture
def lived(
    store: SqlStore, science: FakeScience, settings: Settings, rotor: str, reading: Make, post: Post
) -> str:
    """A rotor with corrections, a retraction, a blade that joined and one that left."""
    post(rotor, reading("a", value=0.13), reading("b", blade="B2", value=1 / 3))
    post(rotor, reading("c", blade="B2", value=0.3, replaces="b", observed_at="2031-05-04T10:00Z"))
    work(store, science, settings)
    post(rotor, reading("wrong", value=3.0))
    retract(store, rotor, "wrong")
    add_blade(store, rotor, BladeRecord("B4", lot="Ω-7", time_h0=100.5))
    retire_blade(store, rotor, "B1")
    post(rotor, reading("d", blade="B4", time_h=20_000.0, value=0.21, sigma=0.01))
    work(store, science, settings)
    return rotor


@pytest.fixture
def file(store: SqlStore, lived: str, tmp_path: Path) -> Path:
    path = tmp_path / "r1.zip"
    export_rotor(store, lived, path, "test")
    return path


def test_a_rotor_is_sealed_bit_identically_in_the_other_database(
    store: SqlStore, elsewhere: SqlStore, science: FakeScience, settings: Settings, file: Path
) -> None:
    done = import_rotor(elsewhere, science, file)
    assert (done.new, done.entries, done.blades) == (True, 8, 4)
    work(elsewhere, science, settings)
    assert sealed(elsewhere, "r1") == sealed(store, "r1")
    assert done.state is not None
    assert done.state["digest"] == sealed(elsewhere, "r1")[0]
    assert log_of(elsewhere, "r1") == log_of(store, "r1"), "with the moments of arrival"
    here, there = view_rotor(store, "r1"), view_rotor(elsewhere, "r1")
    assert there.blades == here.blades
    assert there.rotor.digest == here.rotor.digest
    listed = [list_inspections(one, "r1", 0, 100) for one in (store, elsewhere)]
    assert listed[0] == listed[1]


def test_a_rotor_goes_on_where_it_came_and_can_be_carried_back(
    store: SqlStore,
    elsewhere: SqlStore,
    science: FakeScience,
    settings: Settings,
    file: Path,
    reading: Make,
    tmp_path: Path,
) -> None:
    import_rotor(elsewhere, science, file)
    work(elsewhere, science, settings)
    more = Item("", reading("e", blade="B2", time_h=30_000.0, value=0.4))
    assert post_inspections(elsewhere, "r1", [more])[0].seq == 9
    assert post_inspections(elsewhere, "r1", [Item("", reading("a", value=0.13))])[0].seq == 1
    work(elsewhere, science, settings)
    back = tmp_path / "back.zip"
    export_rotor(elsewhere, "r1", back, "test")
    import_rotor(store, science, back, "r1-back")
    work(store, science, settings)
    assert sealed(store, "r1-back") == sealed(elsewhere, "r1")
    blades = [BladeRecord(name) for name in ("B1", "B2", "B3")]
    assert create_rotor(elsewhere, "r1", "rotor-blade", blades, 64, 7)[2] is False


def test_the_same_rotor_gives_the_same_bytes(store: SqlStore, file: Path, tmp_path: Path) -> None:
    again = tmp_path / "again.zip"
    export_rotor(store, "r1", again, "test")
    assert again.read_bytes() == file.read_bytes()
    assert sorted(p.name for p in tmp_path.glob("*.zip*")) == ["again.zip", "r1.zip"]


def test_a_file_tells_of_no_state_that_rests_on_more_than_it_holds(
    store: SqlStore, science: FakeScience, settings: Settings, lived: str, reading: Make,
    post: Post, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """An entry comes, and is sealed, between two questions of the export."""
    real = transfer_out.blades_at

    def meanwhile(*given: Any) -> Any:
        post(lived, reading("late", time_h=21_000.0))
        work(store, science, settings)
        return real(*given)

    monkeypatch.setattr(transfer_out, "blades_at", meanwhile)
    manifest = export_rotor(store, lived, tmp_path / "r1.zip", "test")
    assert sealed(store, lived)[2] == manifest["head_seq"] + 1
    told = manifest["state"]
    assert told is None or told["through_seq"] == manifest["head_seq"]


def test_two_exports_into_one_file_at_once_leave_it_whole(
    store: SqlStore, lived: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The one that ends last has it; neither writes into what the other has under its hands."""
    target, real, inner = tmp_path / "r.bundle", bundle._write_member, []

    def slow(archive: zipfile.ZipFile, name: str, rows: Iterable[Any]) -> Any:
        if name == "log.jsonl" and not inner:
            inner.append(name)
            export_rotor(store, lived, target, "test")
        return real(archive, name, rows)

    monkeypatch.setattr(bundle, "_write_member", slow)
    manifest = export_rotor(store, lived, target, "test")
    with target.open("rb") as handle:
        assert bundle.opened(target, handle).manifest == manifest
    assert [one.name for one in tmp_path.iterdir() if "bundle" in one.name] == ["r.bundle"]


def test_the_order_of_blades_is_that_of_their_bytes_however_the_database_sorts_text(
    store: SqlStore,
    elsewhere: SqlStore,
    science: FakeScience,
    settings: Settings,
    reading: Make,
    post: Post,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    names = ("B1", "B_1", "a-spare")
    create_rotor(store, "r1", "rotor-blade", [BladeRecord(name) for name in names], 64, 7)
    post("r1", reading("i", blade="a-spare"))
    own = t.blade.c.rotor_id == bindparam("rotor")
    query = select(*records.BLADE).where(own).order_by(func.lower(t.blade.c.id))
    monkeypatch.setattr(records, "_BLADES", Gathered(query))
    with store.read() as tx:
        came = [row[0] for row in records._BLADES.rows(tx.connection, {"rotor": "r1"})]
    assert came == ["a-spare", "B1", "B_1"], "the control: another order than that of the bytes"
    work(store, science, settings)
    view = view_rotor(store, "r1")
    assert view.state is not None
    assert view.state.meta["blades"] == [blade.id for blade in view.blades] == list(names)
    export_rotor(store, "r1", tmp_path / "r1.zip", "test")
    monkeypatch.undo()
    import_rotor(elsewhere, science, tmp_path / "r1.zip")
    work(elsewhere, science, settings)
    assert sealed(elsewhere, "r1") == sealed(store, "r1")


def test_importing_twice_gives_the_same_answer_and_one_rotor(
    elsewhere: SqlStore, science: FakeScience, settings: Settings, file: Path
) -> None:
    first = import_rotor(elsewhere, science, file).to_json()
    work(elsewhere, science, settings)
    second = import_rotor(elsewhere, science, file).to_json()
    assert (first.pop("new"), second.pop("new")) == (True, False)
    assert first == second
    with elsewhere.read() as tx:
        assert [one.id for one in tx.records.rotors("", 10)] == ["r1"]
        assert tx.records.rotor("r1").version == 1, "nothing was computed again"


def test_an_id_that_is_taken_by_another_rotor_is_a_conflict_and_changes_nothing(
    elsewhere: SqlStore, science: FakeScience, file: Path, reading: Make
) -> None:
    register_builtins(elsewhere, science)
    create_rotor(elsewhere, "r1", "rotor-blade", [BladeRecord("other")], 64, 7)
    with pytest.raises(ConflictError, match="--as"):
        import_rotor(elsewhere, science, file)
    assert log_of(elsewhere, "r1") == []
    assert import_rotor(elsewhere, science, file, "r2").rotor.origin == "r1"
    with pytest.raises(ConflictError, match="'r2'"):
        create_rotor(elsewhere, "r2", "rotor-blade", [BladeRecord("other")], 64, 7)


@pytest.mark.parametrize("ahead", ["file", "there"])
def test_a_log_that_parted_from_the_file_is_a_conflict_and_one_that_went_on_is_not(
    store: SqlStore,
    elsewhere: SqlStore,
    science: FakeScience,
    file: Path,
    reading: Make,
    tmp_path: Path,
    ahead: str,
) -> None:
    import_rotor(elsewhere, science, file)
    more = Item("", reading("e", blade="B2", value=0.4))
    grown = store if ahead == "file" else elsewhere
    post_inspections(grown, "r1", [more])
    if ahead == "there":
        assert import_rotor(elsewhere, science, file).new is False
        post_inspections(store, "r1", [Item("", reading("f", blade="B2", value=0.5))])
    later = tmp_path / "later.zip"
    export_rotor(store, "r1", later, "test")
    with pytest.raises(ConflictError, match="r1"):
        import_rotor(elsewhere, science, later)


def test_a_model_that_the_release_does_not_have_is_refused_by_name(
    elsewhere: SqlStore, file: Path
) -> None:
    other = FakeScience(network=formula_science().builtin("rotor-blade").network)
    with pytest.raises(InputError, match="BLADETWIN_MODEL_DIR"):
        import_rotor(elsewhere, other, file)
    with elsewhere.read() as tx:
        assert tx.records.rotors("", 10) == []


@pytest.mark.parametrize(
    ("table", "change"),
    [
        ("rotor", "seed = seed + 1"),
        ("rotor", "particles = 2 * particles"),
        ("blade", "lot = 'L9' WHERE added_seq = 0"),
        ("blade", "slot = '9' WHERE added_seq > 0"),
    ],
)
def test_a_damaged_rotor_is_not_exported_and_no_good_file_is_lost(
    store: SqlStore, lived: str, file: Path, table: str, change: str
) -> None:
    before = file.read_bytes()
    with transaction(store.engine, write=True) as connection:
        assert connection.execute(text(f"UPDATE {table} SET {change}")).rowcount >= 1
    with pytest.raises(DamagedRotorError):
        export_rotor(store, lived, file, "test")
    assert file.read_bytes() == before


def test_a_damaged_log_is_not_exported(store: SqlStore, lived: str, tmp_path: Path) -> None:
    with transaction(store.engine, write=True) as connection:
        connection.execute(text("UPDATE event SET digest = 'x' WHERE seq = 2"))
    with pytest.raises(DamagedLogError, match="b: its body"):
        export_rotor(store, lived, tmp_path / "x.zip", "test")
    assert list(tmp_path.glob("*.zip*")) == []


Members = dict[str, bytes]
Forge = Callable[[Members], Members]


def line(name: str, number: int, **changes: Any) -> Forge:
    """One line of a member says something else, and the manifest is made to agree."""

    def forge(members: Members) -> Members:
        lines = members[name].splitlines(keepends=True)
        row = json.loads(lines[number]) | changes
        lines[number] = json.dumps(row).encode() + b"\n"
        return agreed(members | {name: b"".join(lines)})

    return forge


def agreed(members: Members) -> Members:
    """The members with a manifest that fits them."""
    manifest = json.loads(members["manifest.json"])
    for name, data in members.items():
        if name in bundle.MEMBERS and name != "manifest.json":
            made = bundle.sha256(data).hexdigest()
            told = {"bytes": len(data), "lines": data.count(b"\n"), "sha256": made}
            manifest["files"][name] = told
    return members | {"manifest.json": sign(manifest)}


def sign(manifest: dict[str, Any]) -> bytes:
    return json.dumps(manifest | {"sha256": bundle.digest_of_manifest(manifest)}).encode()


def told(**changes: Any) -> Forge:
    return lambda m: m | {"manifest.json": sign(json.loads(m["manifest.json"]) | changes)}


def cut(name: str) -> Forge:
    return lambda m: agreed(m | {name: b"".join(m[name].splitlines(keepends=True)[:-1])})


READING = {"id": "a", "blade": "B1", "quantity": "elongation", "time_h": 8000.0}


def body(**changes: Any) -> Forge:
    """The first reading says something else, with the right digest of its own."""
    made = READING | {"values": [0.13]} | changes
    try:
        digest = Inspection.from_json(made).digest()
    except (TypeError, ValueError):
        digest = "0"
    return line("log.jsonl", 0, body=json.dumps(made), digest=digest)


FORGERIES: dict[str, tuple[Forge, str]] = {
    "not a member": (lambda m: m | {"../evil": b"x"}, "not just the members"),
    "missing": (lambda m: {k: v for k, v in m.items() if k != "log.jsonl"}, "not just the"),
    "absolute": (lambda m: m | {"/etc/passwd": b"x"}, "not just the members"),
    "other content": (lambda m: m | {"log.jsonl": m["log.jsonl"] + b"{}\n"}, "the manifest says"),
    "other manifest": (
        lambda m: m | {"manifest.json": m["manifest.json"].replace(b"test", b"rest")},
        "another SHA-256",
    ),
    "schema": (told(schema=2), "schema is 2, this release has 1"),
    "format": (told(format="other"), "format is 'other'"),
    "no manifest": (lambda m: m | {"manifest.json": b"[1]"}, "no JSON object"),
    "deep manifest": (lambda m: m | {"manifest.json": b"[" * 100_000}, "no JSON"),
    "head": (told(head_seq=9), "does not agree with the log"),
    "log cut": (cut("log.jsonl"), "does not agree with the log"),
    "blade cut": (cut("blades.jsonl"), "log.jsonl, line 6"),
    "a blade's lot": (line("blades.jsonl", 3, lot="other"), "something else of the blade"),
    "a first blade's lot": (line("blades.jsonl", 0, lot="other"), "do not have the rotor's digest"),
    "blade twice": (line("blades.jsonl", 1, id="B1"), "names a blade twice"),
    "unretired": (line("blades.jsonl", 0, retired_seq=None), "blades.jsonl says otherwise"),
    "seed": (line("rotor.json", 0, seed=8), "do not have the rotor's digest"),
    "rotor id": (line("rotor.json", 0, id="../r1"), "rotor.json: id"),
    "unknown field": (line("rotor.json", 0, colour="red"), "rotor.json: colour"),
    "number as text": (line("rotor.json", 0, seed="7"), "rotor.json: seed"),
    "gap": (line("log.jsonl", 1, seq=3), "it has number 3"),
    "entry's digest": (line("log.jsonl", 1, digest="ab"), "its body has digest"),
    "entry's blade": (line("log.jsonl", 1, blade="B3"), "name another id, blade"),
    "entry's kind": (line("log.jsonl", 1, kind="spell"), "none that this release knows"),
    "retracts nothing": (
        line("log.jsonl", 4, replaces="nix", event_id="retraction/nix"),
        "it retracts nothing",
    ),
    "not finite": (line("log.jsonl", 0, received_at=float("inf")), "received_at"),
    "impossible value": (body(values=[400.0]), "plausible"),
    "unknown blade": (body(blade="B9"), "name another id, blade"),
    "text as unit": (body(unit=5), "unit: Input should be a valid string"),
    "no numbers": (body(values=["x"]), "cannot be read"),
    "long poster": (line("log.jsonl", 0, posted_by="k" * 41), "log.jsonl, line 1: posted_by"),
    "created later": (line("rotor.json", 0, created_at=1e12), "rotor.json: created_at"),
}


def test_who_posted_what_and_when_the_rotor_was_created_come_along(
    store: SqlStore, elsewhere: SqlStore, science: FakeScience, lived: str, tmp_path: Path
) -> None:
    with transaction(store.engine, write=True) as connection:
        connection.execute(text("UPDATE event SET posted_by = 'key-1' WHERE seq < 3"))
        connection.execute(text("UPDATE event SET posted_by = 'loopback' WHERE seq = 3"))
        connection.execute(text("UPDATE rotor SET created_at = created_at - 3600"))
    export_rotor(store, lived, tmp_path / "r1.zip", "test")
    import_rotor(elsewhere, science, tmp_path / "r1.zip")
    assert log_of(elsewhere, "r1") == log_of(store, "r1")
    here, there = view_rotor(store, "r1").rotor, view_rotor(elsewhere, "r1").rotor
    assert there.created_at == here.created_at
    listed = list_inspections(elsewhere, "r1", 0, 100)
    assert [one.posted_by for one in listed[:4]] == ["key-1", "key-1", "loopback", None]
    with pytest.raises(GoneError):
        view_rotor(elsewhere, "r1", Which(at=here.created_at + 60.0))
    with pytest.raises(RangeError, match="the rotor's time till now"):
        view_rotor(elsewhere, "r1", Which(at=here.created_at - 60.0))


def test_a_file_that_does_not_say_so_is_read_as_before(
    store: SqlStore, elsewhere: SqlStore, science: FakeScience, file: Path
) -> None:
    members = unpacked(file)
    assert b"posted_by" not in members["log.jsonl"]
    row = json.loads(members["rotor.json"])
    del row["created_at"]
    packed(agreed(members | {"rotor.json": json.dumps(row).encode() + b"\n"}), file)
    before = view_rotor(store, "r1").rotor.created_at
    import_rotor(elsewhere, science, file)
    assert view_rotor(elsewhere, "r1").rotor.created_at > before, "at the import"
    assert log_of(elsewhere, "r1") == log_of(store, "r1")


def packed(members: Members, path: Path) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(name, data)


def unpacked(path: Path) -> Members:
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def nothing_came_of(path: Path, store: SqlStore, match: str) -> None:
    with pytest.raises(BundleError, match=match):
        import_rotor(store, FakeScience(), path)
    with store.read() as tx:
        assert tx.records.rotors("", 10) == []
        assert tx.connection.execute(select(t.entry)).first() is None


def test_a_file_that_is_wrong_in_any_way_is_refused_and_nothing_is_stored(
    elsewhere: SqlStore, file: Path, tmp_path: Path
) -> None:
    bad = tmp_path / "bad.zip"
    for name, (forge, match) in FORGERIES.items():
        packed(forge(unpacked(file)), bad)
        try:
            nothing_came_of(bad, elsewhere, match)
        except AssertionError as error:
            raise AssertionError(f"{name}: {error}") from error
    packed(agreed(unpacked(file)), bad)
    assert import_rotor(elsewhere, FakeScience(), bad).new, "the forger's tools alone are harmless"


def test_bytes_that_flip_in_the_file_are_noticed(
    elsewhere: SqlStore, file: Path, tmp_path: Path
) -> None:
    whole = file.read_bytes()
    bad = tmp_path / "bad.zip"
    for place in range(40, len(whole), len(whole) // 25):
        bad.write_bytes(whole[:place] + bytes([whole[place] ^ 0x40]) + whole[place + 1 :])
        try:
            done = import_rotor(elsewhere, FakeScience(), bad, "flipped")
        except BladetwinError:
            continue
        assert done.entries == 8, "a byte that says nothing, e.g. of a date"
    for cut_at in (0, 10, len(whole) // 2, len(whole) - 1):
        bad.write_bytes(whole[:cut_at])
        with pytest.raises(BundleError):
            import_rotor(elsewhere, FakeScience(), bad)


def test_a_bomb_is_refused_before_it_is_unpacked(
    elsewhere: SqlStore, file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bad = tmp_path / "bad.zip"
    packed(agreed(unpacked(file) | {"log.jsonl": b" " * (20 * bundle.MIB)}), bad)
    assert bad.stat().st_size < bundle.MIB
    read: list[str] = []
    real = zipfile.ZipFile.open
    monkeypatch.setattr(
        zipfile.ZipFile, "open", lambda self, name, *a, **k: read.append(name) or real(self, name)
    )
    nothing_came_of(bad, elsewhere, "more than 200-fold")
    assert read == []
    monkeypatch.setattr(bundle, "MOST_RATIO", 10**9)
    monkeypatch.setattr(bundle, "LONGEST_LINE", bundle.MIB)
    nothing_came_of(bad, elsewhere, "or a line of it")
    monkeypatch.setitem(bundle.MEMBERS, "log.jsonl", bundle.MIB)  # type: ignore[arg-type]
    nothing_came_of(bad, elsewhere, "above 1048576")


def test_a_file_whose_directory_lies_about_sizes_is_refused(
    elsewhere: SqlStore, file: Path, tmp_path: Path
) -> None:
    """The directory says one byte, the member unpacks to 20 MiB."""
    made = BytesIO()
    big = b"[" + b" " * (20 * bundle.MIB) + b"]\n"
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in (unpacked(file) | {"log.jsonl": big}).items():
            archive.writestr(name, data)
    size = len(big).to_bytes(4, "little")
    bad = tmp_path / "bad.zip"
    bad.write_bytes(made.getvalue().replace(size, (1).to_bytes(4, "little")))
    nothing_came_of(bad, elsewhere, "zip file|manifest says")


def test_the_shipped_model_s_posterior_is_sealed_bit_identically_in_the_other_database_under_any_id(
    store: SqlStore, elsewhere: SqlStore, settings: Settings, reading: Make, tmp_path: Path
) -> None:
    """The origin keys the random numbers: without it a rotor under another id draws others."""
    science = CoreScience()
    with store.write() as tx:
        tx.connection.execute(t.model.delete())
    register_builtins(store, science)
    create_rotor(store, "r1", "rotor-blade", [BladeRecord("B1"), BladeRecord("B2")], 512, 5)
    for i, (blade, value) in enumerate((("B1", 0.11), ("B2", 0.12), ("B1", 0.19))):
        one = reading(f"i{i}", blade=blade, value=value, time_h=8e3 * (i + 1), sigma=0.003)
        post_inspections(store, "r1", [Item("", one)])
        work(store, science, settings)
    path = tmp_path / "r1.zip"
    export_rotor(store, "r1", path, "test")
    again = CoreScience()
    for name in ("r1", "copy"):
        import_rotor(elsewhere, again, path, name)
        work(elsewhere, again, settings)
        assert sealed(elsewhere, name) == sealed(store, "r1")
        assert replay(elsewhere, again, name)["same"] is True
    with transaction(elsewhere.engine, write=True) as connection:
        connection.execute(text("UPDATE rotor SET origin = NULL WHERE id = 'copy'"))
    assert replay(elsewhere, again, "copy")["same"] is False, "mutant"


def test_both_commands_answer_with_one_object(
    store: SqlStore,
    elsewhere: SqlStore,
    settings: Settings,
    lived: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("BLADETWIN_SCIENCE", "fake")
    path = tmp_path / "out.zip"

    def call(url: str, *words: str) -> tuple[int, Any]:
        monkeypatch.setenv("BLADETWIN_DATABASE_URL", url)
        result = CliRunner().invoke(commands, [*words, "--json"])
        return result.exit_code, result.exception if result.exit_code else json.loads(result.stdout)

    code, told = call(settings.database_url, "export", lived, str(path))
    assert (code, told["head_seq"], told["bytes"]) == (0, 8, path.stat().st_size)
    code, error = call(settings.database_url, "export", lived, str(path))
    assert (code, "is there already" in str(error)) == (1, True)
    assert call(settings.database_url, "export", lived, str(path), "--force")[0] == 0
    url = elsewhere.engine.url.render_as_string(False)
    code, told = call(url, "import", str(path), "--as", "r9")
    assert (code, told["rotor"], told["origin"], told["new"]) == (0, "r9", "r1", True)
    assert call(url, "import", str(path), "--as", "r9")[1]["new"] is False
    code, error = call(url, "import", str(path), "--as", "a/b")
    assert (code, "is no id" in str(error)) == (1, True)
