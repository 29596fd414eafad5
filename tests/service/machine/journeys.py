"""Exported files come back under the same and another id, here and in another database."""

from __future__ import annotations

from contextlib import suppress

from hypothesis import strategies as st

from service.bootstrap import make_worker
from service.errors import ConflictError
from service.handlers.rotors import view_rotor
from service.handlers.transfer_in import Imported, import_rotor
from service.handlers.transfer_out import export_rotor
from service.ports import Event
from service.store.entries import read_entries
from service.store.unit_of_work import SqlStore
from tests.service.machine.log import Log
from tests.service.machine.steps import act, rotors
from tests.service.modelled import Modelled


class Journeys(Log):
    """Files of rotors, and another database."""

    def __init__(self) -> None:
        super().__init__()
        self.abroad: dict[str, int] = {}  # the last entry of a rotor there, by its id

    @act(
        3, rotor=rotors, what=st.sampled_from(["export", "bring", "both"]), which=st.integers(0, 3)
    )
    def journey(self, rotor: str, what: str, which: int) -> None:
        if what != "bring":
            self.export(rotor, which > 1)
        if what != "export":
            self.bring(rotor, which, which % 2 == 1)

    def export(self, rotor: str, at_rest: bool) -> None:
        model = self.model.get(rotor)
        if model is None:
            return
        if at_rest:
            self.drain()
        path = self.folder / f"{self.id(rotor)}-{len(model.files)}.zip"
        manifest = export_rotor(self.store, self.id(rotor), path, "test")
        assert manifest["head_seq"] == len(model.entries)
        assert manifest["state"] is not None or not at_rest
        if manifest["state"] is not None:
            through, digest = (manifest["state"][name] for name in ("through_seq", "digest"))
            assert through == len(model.entries) or not at_rest
            assert model.sealed.setdefault(through, digest) == digest
        model.files.append((path, len(model.entries)))

    def bring(self, rotor: str, which: int, copy: bool) -> None:
        """Elsewhere it is the same rotor, or a copy under another id; here it is there already."""
        model = self.model.get(rotor)
        if model is None or not model.files:
            return
        path, head = model.files[which % len(model.files)]
        assert not import_rotor(self.store, self.science, path).new
        there = f"{self.id(rotor)}-copy" if copy else self.id(rotor)
        known = self.abroad.get(there)
        told: Imported | None = None
        with suppress(ConflictError):
            told = import_rotor(self.elsewhere, self.science, path, there)
        if known is not None and known < head:
            assert told is None
            return
        assert told is not None
        assert told.new == (known is None)
        assert told.rotor.origin == (self.id(rotor) if copy else None)
        if known is None:
            self.abroad[there] = head
            make_worker(self.elsewhere, self.science, self.service, "abroad").drain()
        self.compare_abroad(rotor, model, there)

    def compare_abroad(self, rotor: str, model: Modelled, there: str) -> None:
        head = self.abroad[there]
        assert entries(self.elsewhere, there) == entries(self.store, self.id(rotor))[:head]
        view = view_rotor(self.elsewhere, there)
        assert view.state is not None
        assert view.state.sealed
        assert view.state.through_seq == view.rotor.head_seq == head
        assert model.sealed.setdefault(head, view.state.digest) == view.state.digest
        effects = [(one["diagnosis"], one["value"]) for one in view.adopted.effects]
        assert effects == model.sheets(head)


def entries(store: SqlStore, rotor: str) -> list[Event]:
    with store.read() as tx:
        return read_entries(tx.connection, rotor, 0, 2**62)
