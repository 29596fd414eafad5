"""Updates: exact posteriors, any order of arrival, provisional states, blocked rotors."""

from __future__ import annotations

import signal
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from sqlalchemy import select, update

from core.errors import CalibrationError
from core.observation import Inspection
from service.bootstrap import make_worker
from service.errors import FaultsError, StoreAwayError
from service.fake import FakeScience, FakeState
from service.handlers.blades import add_blade, retire_blade
from service.handlers.inspections import retract
from service.handlers.rotors import create_rotor, retry, view_rotor
from service.ports import BladeRecord, ModelCard, RotorSpec
from service.settings import Settings
from service.store import creation, log, named, outbox, versions, webhooks, whole
from service.store import tables as t
from service.store.engine import transaction
from service.store.unit_of_work import SqlStore
from service.worker import claiming, lease, new_version, task
from service.worker import update as updates
from service.worker.claiming import Role
from service.worker.heartbeat import heartbeats
from service.worker.loop import Worker
from tests.patience import until

Make = Callable[..., Inspection]
Post = Callable[..., int]


def test_the_posterior_is_the_conjugate_one(
    store: SqlStore, worker: Worker, rotor: str, reading: Make, post: Post
) -> None:
    post(rotor, reading("a", time_h=25_000.0, value=0.45, sigma=0.05))
    worker.drain()
    view = view_rotor(store, rotor)
    assert view.state is not None
    get = store.arrays(rotor, view.rotor.version)
    # One reading y = r h at h = 1/2: r has variance (0.05/h)², and m adds the scatter 0.2².
    other = 0.1**2 + 0.2**2 + 0.1**2
    mean = 0.5 + 0.1**2 / other * (0.9 - 0.5)
    assert get("shared/moments") == pytest.approx([mean, 0.1**2 * (1 - 0.1**2 / other)], rel=1e-12)
    assert (view.rotor.applied_seq, view.state.through_seq, view.state.sealed) == (1, 1, True)


def test_a_rotor_without_reading_gets_its_prior(
    store: SqlStore, worker: Worker, rotor: str
) -> None:
    worker.drain()
    assert view_rotor(store, rotor).has_applied(0)
    assert store.arrays(rotor, 1)("shared/moments") == pytest.approx([0.5, 0.01], rel=1e-12)


def test_every_order_of_arrival_with_corrections_and_retractions_gives_the_same_state(
    store: SqlStore, science: FakeScience, settings: Settings, reading: Make, post: Post
) -> None:
    blades = [BladeRecord(name) for name in ("B1", "B2")]
    readings = [
        reading("a", time_h=8000.0, value=0.13),
        reading("b", time_h=16000.0, value=0.21, blade="B2"),
        reading("c", time_h=4000.0, value=0.07),
        reading("d", time_h=16000.0, value=0.25, blade="B2", replaces="b"),
        reading("wrong", time_h=2000.0, value=3.0),
    ]
    digests = set()
    for order in ([0, 1, 2, 3, 4], [4, 3, 2, 1, 0], [3, 0, 4, 1, 2]):
        name = "r" + "".join(map(str, order))
        create_rotor(store, name, "rotor-blade", blades, 64, 7)
        one_by_one = make_worker(store, science, settings, name)
        for i in order:
            post(name, readings[i])
            one_by_one.drain()
        retract(store, name, "wrong")
        one_by_one.drain()
        state = view_rotor(store, name).state
        assert state is not None
        digests.add((state.digest, state.events_digest))
    assert len(digests) == 1
    create_rotor(store, "without", "rotor-blade", blades, 64, 7)
    post("without", readings[0], readings[2], readings[3])
    make_worker(store, science, settings).drain()
    state = view_rotor(store, "without").state
    assert state is not None
    assert {(state.digest, state.events_digest)} == digests


def test_all_pending_entries_become_one_version(
    store: SqlStore, worker: Worker, rotor: str, reading: Make, post: Post
) -> None:
    worker.drain()
    for i in range(30):
        post(rotor, reading(f"i{i}", time_h=1000.0 + i))
    worker.drain()
    view = view_rotor(store, rotor)
    assert (view.rotor.version, view.rotor.applied_seq) == (2, 30)


def test_only_arrays_that_changed_are_written(
    store: SqlStore, worker: Worker, rotor: str, reading: Make, post: Post
) -> None:
    worker.drain()
    post(rotor, reading("a", blade="B2"))
    worker.drain()
    query = select(t.state_array.c.name).where(t.state_array.c.version == 2)
    with store.read() as tx:
        written = set(tx.connection.execute(query).scalars())
    assert written == {"column/B2", "shared/moments"}
    again = make_worker(store, FakeScience(), worker.settings, "restarted")
    post(rotor, reading("b", blade="B3"))
    again.drain()
    query = select(t.state_array.c.name).where(t.state_array.c.version == 3)
    with store.read() as tx:
        written = set(tx.connection.execute(query).scalars())
    assert written == {"column/B3", "shared/moments"}


def test_a_provisional_state_is_shown_as_such_and_then_sealed(
    store: SqlStore, settings: Settings, rotor: str, reading: Make, post: Post
) -> None:
    worker = make_worker(store, FakeScience(provisional=True), settings)
    post(rotor, reading("a"))
    seen = []
    while worker.updater.run_once():
        view = view_rotor(store, rotor)
        assert view.state is not None
        seen.append((view.rotor.version, view.state.sealed, view.rotor.applied_seq))
    assert seen == [(1, False, 1), (2, True, 1)]


def test_a_new_blade_is_in_the_next_posterior_and_a_retired_one_stays(
    store: SqlStore, worker: Worker, rotor: str, reading: Make, post: Post
) -> None:
    post(rotor, reading("a", blade="B1", value=0.2))
    with pytest.raises(FaultsError, match="B4"):
        post(rotor, reading("b", blade="B4"))
    assert add_blade(store, rotor, BladeRecord("B4", lot="L2")).seq == 2
    assert retire_blade(store, rotor, "B1").seq == 3
    post(rotor, reading("b", blade="B4"))
    worker.drain()
    view = view_rotor(store, rotor)
    assert view.state is not None
    assert view.state.meta["blades"] == ["B1", "B2", "B3", "B4"]
    assert store.arrays(rotor, view.rotor.version)("column/B1")[0] > 0
    assert [b.retired_seq for b in view.blades] == [3, None, None, None]


def test_a_worker_forgets_what_another_worker_has_overtaken(
    store: SqlStore, settings: Settings, rotor: str, reading: Make, post: Post
) -> None:
    science = FakeScience()
    first, second = (make_worker(store, science, settings, name) for name in ("w1", "w2"))
    post(rotor, reading("a"))
    first.drain()
    post(rotor, reading("b", blade="B2", value=0.15))
    second.drain()
    post(rotor, reading("c", blade="B3", value=0.05))
    first.drain()
    view = view_rotor(store, rotor)
    assert view.state is not None
    assert view.state.meta["readings"] == 3
    for blade in ("B1", "B2", "B3"):
        assert store.arrays(rotor, view.rotor.version)(f"column/{blade}")[0] > 0


class Choosy(FakeScience):
    """Refuses readings of campaign ``bad``; names them only where `names` is set."""

    names = False

    def update(
        self,
        card: ModelCard,
        rotor: RotorSpec,
        readings: Sequence[Inspection],
        previous: Any,
        *,
        quick: bool,
    ) -> FakeState:
        for one in readings:
            if one.campaign == "bad":
                message = "no particle explains it"
                raise CalibrationError(message, event=one.id if self.names else None)
        return super().update(card, rotor, readings, previous, quick=quick)


class Naming(Choosy):
    names = True


@pytest.mark.parametrize("science_type", [Choosy, Naming])
def test_after_its_attempts_a_rotor_is_blocked_with_the_reading_named_and_others_go_on(
    store: SqlStore,
    settings: Settings,
    rotor: str,
    reading: Make,
    post: Post,
    science_type: type[Choosy],
) -> None:
    worker = make_worker(store, science_type(), settings)
    create_rotor(store, "other", "rotor-blade", [BladeRecord("B1")], 64, 7)
    post(rotor, *[reading(f"good{i}") for i in range(5)])
    post(rotor, reading("culprit", campaign="bad"), reading("later"))
    post("other", reading("fine"))
    worker.drain()
    blocked = view_rotor(store, rotor).rotor
    assert (blocked.blocked, blocked.last_error_event) == (True, "culprit")
    assert blocked.attempts == settings.max_attempts
    assert "no particle explains it" in str(blocked.last_error)
    assert view_rotor(store, "other").has_applied(1)
    assert blocked.applied_seq == 0

    retry(store, rotor)
    worker.drain()
    assert view_rotor(store, rotor).rotor.blocked, "nothing changed, so it blocks again"

    retract(store, rotor, "culprit")
    worker.drain()
    freed = view_rotor(store, rotor)
    assert freed.has_applied(8)
    assert (freed.rotor.blocked, freed.rotor.last_error) == (False, None)


def test_a_correction_of_what_blocks_a_rotor_frees_it_and_no_other_does(
    store: SqlStore, settings: Settings, rotor: str, reading: Make, post: Post
) -> None:
    """As the pages say: it stayed blocked until somebody tried it again as well."""
    worker = make_worker(store, Choosy(), settings)
    post(rotor, reading("good"), reading("culprit", campaign="bad"))
    worker.drain()
    assert view_rotor(store, rotor).rotor.last_error_event == "culprit"
    post(rotor, reading("other", replaces="good"))
    worker.drain()
    assert view_rotor(store, rotor).rotor.blocked
    post(rotor, reading("right", replaces="culprit"), reading("later"))
    worker.drain()
    freed = view_rotor(store, rotor)
    assert (freed.rotor.blocked, freed.has_applied(5)) == (False, True)
    assert freed.rotor.last_error is None


@pytest.mark.parametrize("free", ["retract", "retry"])
def test_a_rotor_that_is_freed_during_its_last_attempt_is_tried_again(
    store: SqlStore, settings: Settings, rotor: str, reading: Make, post: Post, free: str
) -> None:
    tried: list[str] = []

    class Slow(Choosy):
        def update(self, *given: Any, **more: Any) -> FakeState:
            tried.append("")
            if len(tried) == 2:
                if free == "retract":
                    retract(store, rotor, "culprit")
                else:
                    retry(store, rotor)
            if len(tried) > 3 and free == "retry":
                return FakeScience.update(self, *given, **more)
            return super().update(*given, **more)

    twice = settings.model_copy(update={"max_attempts": 2, "retry_base_s": 0.0})
    post(rotor, reading("culprit", campaign="bad"))
    worker = make_worker(store, Slow(), twice)
    for _ in range(2):
        assert worker.updater.run_once()
    view = view_rotor(store, rotor).rotor
    assert (view.blocked, view.attempts) == (False, 0)
    assert "no particle explains it" in str(view.last_error)
    with store.read() as tx:
        assert [note.kind for note in tx.outbox.after(rotor, 0, 10)] == []
        assert tx.connection.execute(select(t.cursor.c.not_before)).scalar() is None
    worker.drain()
    assert view_rotor(store, rotor).has_applied(2 if free == "retract" else 1)


def test_a_failed_update_pauses_before_it_is_tried_again(
    store: SqlStore, settings: Settings, rotor: str, reading: Make, post: Post
) -> None:
    patient = settings.model_copy(update={"retry_base_s": 3600.0, "retry_max_s": 3600.0})
    worker = make_worker(store, Choosy(), patient)
    post(rotor, reading("culprit", campaign="bad"))
    worker.drain()
    view = view_rotor(store, rotor).rotor
    assert (view.attempts, view.blocked) == (1, False)
    assert not worker.updater.run_once()
    retry(store, rotor)
    assert worker.updater.run_once()


@pytest.mark.parametrize(
    ("module", "where"),
    [(new_version, "write_state"), (task, "read_entries"), (new_version, "alarm")],
)
def test_a_database_that_is_away_or_full_never_blocks_a_rotor(
    module: ModuleType,
    where: str,
    store: SqlStore,
    settings: Settings,
    worker: Worker,
    rotor: str,
    post: Post,
    reading: Make,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Other errors do: `test_after_its_attempts_a_rotor_is_blocked…` is the control."""
    post(rotor, reading("i1"))
    right, left = getattr(module, where), [settings.max_attempts + 2]

    def full(*given: Any, **more: Any) -> Any:
        if left[0]:
            left[0] -= 1
            raise StoreAwayError("DiskFull")
        return right(*given, **more)

    monkeypatch.setattr(module, where, full)
    for _ in range(settings.max_attempts + 2):
        with pytest.raises(StoreAwayError):
            worker.updater.run_once()
        with store.read() as tx:
            row = tx.connection.execute(select(t.cursor.c.owner, t.cursor.c.attempts)).one()
        assert tuple(row) == (None, 0)
    worker.drain()
    assert view_rotor(store, rotor).has_applied(1)


def test_an_update_builds_none_of_its_statements_anew(
    store: SqlStore, worker: Worker, rotor: str, reading: Make, post: Post,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """But for those of SQLite's claims. To build one takes as long as to have it answered."""
    post(rotor, reading("i1"))
    worker.drain()
    post(rotor, reading("i2"))

    def built(*given: Any, **more: Any) -> Any:
        raise AssertionError("a statement is built")

    for module in (lease, log, outbox, task, versions, webhooks, creation, named, whole):
        for name in ("insert", "select", "text", "update"):
            monkeypatch.setattr(module, name, built, raising=False)
    assert worker.updater.run_once()
    assert view_rotor(store, rotor).has_applied(2)
    with pytest.raises(AssertionError, match="a statement is built"):
        lease.release(store.engine, "nobody")


def die(store: SqlStore, settings: Settings, role: Role = "all") -> None:
    """As many workers claim the rotor and die as may."""
    for i in range(settings.max_attempts):
        assert claiming.claim(store.engine, f"dead{i}", 60.0, role=role) is not None
        assert lease.release(store.engine, f"dead{i}") == 1


def test_an_entry_that_kills_every_worker_blocks_its_rotor_and_is_named(
    store: SqlStore, settings: Settings, worker: Worker, rotor: str, reading: Make, post: Post
) -> None:
    post(rotor, reading("a"))
    die(store, settings)
    worker.drain()
    view = view_rotor(store, rotor).rotor
    assert (view.blocked, view.last_error_event) == (True, "a")
    assert "5 workers died or lost their lease during the update" in str(view.last_error)
    assert str(view.last_error).endswith("Not applied yet: entry 1 (a).")
    retry(store, rotor)
    worker.drain()
    assert view_rotor(store, rotor).has_applied(1)


def test_of_several_entries_that_kill_every_worker_none_is_named_but_which_they_are(
    store: SqlStore, settings: Settings, worker: Worker, rotor: str, reading: Make, post: Post
) -> None:
    post(rotor, reading("a"), reading("b"))
    worker.drain()
    post(rotor, reading("c"))
    retract(store, rotor, "b")
    die(store, settings)
    worker.drain()
    view = view_rotor(store, rotor).rotor
    assert (view.blocked, view.last_error_event) == (True, None)
    assert "Not applied yet: entries 3 (c) to 4 (b)." in str(view.last_error)


@pytest.mark.parametrize("later", [False, True])
def test_of_a_sealing_that_kills_every_worker_no_entry_is_blamed(
    store: SqlStore, settings: Settings, rotor: str, reading: Make, post: Post, later: bool
) -> None:
    """Least of all one that came after it."""
    worker = make_worker(store, FakeScience(provisional=True), settings)
    post(rotor, reading("a"), reading("b"))
    assert worker.updater.run_once()
    die(store, settings, "seal")
    if later:
        post(rotor, reading("innocent"))
    worker.drain()
    view = view_rotor(store, rotor).rotor
    assert (view.blocked, view.last_error_event) == (True, None)
    text = str(view.last_error)
    assert "workers died" in text
    expected = (
        "applied yet: entry 3 (innocent)." if later else "sealed yet: entries 1 (a) to 2 (b)."
    )
    assert text.endswith(f"Not {expected}")
    assert ("during the sealing" in text) is not later


@pytest.mark.parametrize("also", [(), ("b",)])
def test_a_reading_that_stops_the_sealing_is_named_where_it_alone_is_new(
    store: SqlStore,
    settings: Settings,
    rotor: str,
    reading: Make,
    post: Post,
    also: tuple[str, ...],
) -> None:
    class Sealing(Choosy):
        def update(self, *given: Any, quick: bool) -> FakeState:
            if quick:
                return FakeScience.update(self, *given, quick=quick)
            return super().update(*given, quick=quick)

    worker = make_worker(store, Sealing(provisional=True), settings)
    post(rotor, reading("a"))
    worker.drain()
    post(rotor, reading("culprit", campaign="bad"), *(reading(name) for name in also))
    worker.drain()
    view = view_rotor(store, rotor).rotor
    assert (view.blocked, view.applied_seq) == (True, 2 + len(also))
    assert "no particle explains it" in str(view.last_error)
    assert view.last_error_event == (None if also else "culprit")
    if also:
        assert "explains it. To try each alone takes too long" in str(view.last_error)
        assert "Not sealed yet: entries 2 (culprit) to 3 (b)." in str(view.last_error)


class Short(FakeScience):
    """Has no memory for the updates that `refuses` names by their number: 1, 2 …"""

    refuses: Callable[[int], bool]
    tried: list[int]

    def __init__(self, refuses: Callable[[int], bool]) -> None:
        super().__init__()
        object.__setattr__(self, "refuses", refuses)
        object.__setattr__(self, "tried", [])

    def update(
        self, card: ModelCard, rotor: RotorSpec, readings: Any, *given: Any, **more: Any
    ) -> Any:
        self.tried.append(len(readings))
        if self.refuses(len(self.tried)):
            raise MemoryError
        return super().update(card, rotor, readings, *given, **more)


def test_no_reading_is_named_where_the_update_passes_on_another_try(
    store: SqlStore, settings: Settings, worker: Worker, rotor: str, reading: Make, post: Post
) -> None:
    post(rotor, *[reading(f"i{i}") for i in range(5)])
    short = Short(lambda number: number <= settings.max_attempts)
    make_worker(store, short, settings).drain()
    view = view_rotor(store, rotor).rotor
    assert (view.blocked, view.last_error_event) == (True, None)
    assert view.last_error == "MemoryError. It passed on another try, so no entry is named."
    assert short.tried == [5] * (settings.max_attempts + 1)
    retry(store, rotor)
    worker.drain()
    assert view_rotor(store, rotor).has_applied(5)


def test_no_reading_is_named_where_the_update_fails_without_the_new_ones_too(
    store: SqlStore, settings: Settings, worker: Worker, rotor: str, reading: Make, post: Post
) -> None:
    post(rotor, reading("a"))
    worker.drain()
    post(rotor, reading("b"), reading("c"))
    make_worker(store, Short(lambda number: True), settings).drain()
    view = view_rotor(store, rotor).rotor
    assert (view.blocked, view.last_error_event) == (True, None)
    assert "fails without the new entries, too" in str(view.last_error)
    assert "Not applied yet: entries 2 (b) to 3 (c)." in str(view.last_error)


def test_an_entry_that_is_no_reading_is_named_as_well(
    store: SqlStore, settings: Settings, worker: Worker, rotor: str, reading: Make, post: Post
) -> None:
    class Small(FakeScience):
        def update(self, *given: Any, **more: Any) -> FakeState:
            if "B4" in given[1].blades:
                raise ValueError("four blades")
            return super().update(*given, **more)

    worker.drain()
    post(rotor, reading("a"))
    add_blade(store, rotor, BladeRecord("B4"))
    post(rotor, reading("b"))
    make_worker(store, Small(), settings).drain()
    view = view_rotor(store, rotor).rotor
    assert (view.blocked, view.last_error_event) == (True, "blade/B4")
    assert view.last_error == "ValueError: four blades"


def test_nobody_takes_a_rotor_while_its_culprit_is_looked_for(
    store: SqlStore,
    settings: Settings,
    rotor: str,
    reading: Make,
    post: Post,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """However long it takes: each time the lease is over, and a beat prolongs it."""
    often = lambda beat, lease_s, *more: heartbeats(beat, 0.03, *more)  # noqa: E731
    monkeypatch.setattr(updates, "heartbeats", often)
    taken: list[object] = []

    def lease_runs() -> bool:
        with store.read() as tx:
            return bool(tx.connection.execute(select(t.cursor.c.lease_until > 1.0)).scalar_one())

    class Slow(Choosy):
        def update(self, *given: Any, **more: Any) -> FakeState:
            with transaction(store.engine, write=True) as connection:
                connection.execute(update(t.cursor).values(lease_until=1.0))
            until("a beat", lease_runs)
            taken.append(claiming.claim(store.engine, "other", 30.0))
            return super().update(*given, **more)

    once = settings.model_copy(update={"max_attempts": 1})
    post(rotor, *[reading(f"i{i}") for i in range(3)], reading("culprit", campaign="bad"))
    make_worker(store, Slow(), once).drain()
    assert view_rotor(store, rotor).rotor.last_error_event == "culprit"
    assert taken == [None] * 5, "the attempt, another one, one without, and two of the bisection"


def test_a_worker_that_is_told_to_end_gives_what_it_computes_back_uncounted(
    store: SqlStore, settings: Settings, rotor: str, reading: Make, post: Post
) -> None:
    class Told(FakeScience):
        def update(self, *given: Any, quick: bool) -> FakeState:
            if not quick:
                try:
                    signal.raise_signal(signal.SIGTERM)
                except Exception:
                    pytest.fail("it is no failure of the computing")
                reached.append("")
            return super().update(*given, quick=quick)

    reached: list[str] = []
    worker = make_worker(store, Told(provisional=True), settings)
    before = signal.signal(signal.SIGTERM, worker.stop)
    try:
        post(rotor, reading("a"))
        worker.drain()
    finally:
        signal.signal(signal.SIGTERM, before)
    assert not reached, "negative control: the sealing began and did not go on"
    with store.read() as tx:
        row = tx.connection.execute(select(t.cursor)).one()
    assert (row.version, row.owner, row.lease_until, row.attempts) == (1, None, None, 0)
    assert (row.dirty, row.last_error) == (True, None)
    make_worker(store, FakeScience(), settings).drain()
    state = view_rotor(store, rotor).state
    assert state is not None
    assert state.sealed


def test_a_field_of_a_whole_mesh_is_applied(
    store: SqlStore, worker: Worker, rotor: str, post: Post
) -> None:
    nodes = np.arange(6448)
    values = np.zeros((6448, 3))
    values[:, 2] = 0.3 * (nodes + 1) / 6448
    post(rotor, Inspection("scan", "B1", "deformation", 25_000.0, values, nodes))
    worker.drain()
    n, s = store.arrays(rotor, 1)("column/B1")
    assert s / n == pytest.approx(0.6, rel=1e-12)


def test_a_job_registers_a_model_once_and_a_broken_one_fails_with_its_reason(
    store: SqlStore, worker: Worker
) -> None:
    with store.write() as tx:
        tx.records.put_job("j1", "register-model", {"builtin": "rotor-blade"})
        tx.records.put_job("j2", "register-model", {"builtin": "other"})
    worker.drain()
    with store.read() as tx:
        done, failed = tx.records.job("j1"), tx.records.job("j2")
        assert len(tx.records.models("", 10)) == 1
    assert (done.status, failed.status) == ("done", "failed")
    assert done.result is not None
    assert done.result["model"] == "rotor-blade"
    assert "other" in str(failed.error)
