"""The tables of models, rotors, their logs and posteriors, and jobs.

The inspection log (`event`) is the queue. `rotor.head_seq` is the number of the newest event and
is touched by ingest alone; `cursor.applied_seq` is the newest event that the posterior rests on
and moves only together with a new row of `state`. `rotor` and `cursor` are two tables so that a
worker's claim never blocks ingest. Times are seconds since 1970 (UTC) by the database's clock.

`state_array` holds an array under the version that last changed it: version v of a rotor has, for
each name, the row with the greatest version <= v. A row with an empty dtype says that the name
ended there.

`job` is long work; `rotor_id` names the rotor of a job that belongs to one (a diagnosis), and
`progress` is what its worker wrote last. `event.traceparent` and `job.traceparent` are those of the
request that wrote the row, where it was traced (`service.tracing`); no digest covers them, and they
stay behind where a rotor is exported.

`residual` holds what a worker of the role `diagnose` made of the newest sealed version that it has
looked at: every reading predicted before it was used, and tests. Versions newer than its own are
its queue; `fence`, `owner` and `lease_until` are those of whoever computes them. `judged` is the
newest version of which it was decided whether its alarms ask for a diagnosis, `asked` what alarmed
when they last did (`service.worker.asking`).

`blob` holds files in parts by their SHA-256: runs that were uploaded, until their job has ended,
and trained surrogates, which the row of their model names.
`rotor.origin` is the id under which an imported rotor draws its random numbers, where that is not
its own; `rotor.adopt` says whether a diagnosis is adopted by itself, `rotor.diagnose` whether one
is asked for by itself, as it was created: `adopt_now` and `diagnose_now` since somebody decided so
anew. `cursor.outbox_dropped` is the newest note of the outbox that is no longer kept.

Who calls and who is told have tables of their own: `access_tables`, `hook_tables`.
"""

from __future__ import annotations

from sqlalchemy import (
    DDL,
    Boolean,
    Column,
    Double,
    ForeignKey,
    ForeignKeyConstraint,
    Index,
    Integer,
    LargeBinary,
    String,
    Table,
    Text,
    UniqueConstraint,
    event,
)

from service.store.schema import BIG, NAME, metadata

model = Table(
    "model",
    metadata,
    Column("id", NAME, primary_key=True),
    Column("version", NAME, primary_key=True),
    Column("digest", String(64), nullable=False),
    Column("source", Text, nullable=False),
    Column("card", Text, nullable=False),
    Column("created_at", Double, nullable=False),
)

job = Table(
    "job",
    metadata,
    Column("id", NAME, primary_key=True),
    Column("kind", String(40), nullable=False),
    Column("status", String(20), nullable=False),
    Column("request", Text, nullable=False),
    Column("result", Text),
    Column("error", Text),
    Column("attempts", Integer, nullable=False),
    Column("fence", BIG, nullable=False),
    Column("owner", NAME),
    Column("lease_until", Double),
    Column("not_before", Double),
    Column("created_at", Double, nullable=False),
    Column("finished_at", Double),
    Column("rotor_id", NAME),
    Column("progress", Text),
    Column("traceparent", String(60)),
    Column("kept", Text),
    Index("ix_job_status_created_at", "status", "created_at"),
    Index("ix_job_rotor_id_id", "rotor_id", "id"),
)

rotor = Table(
    "rotor",
    metadata,
    Column("id", NAME, primary_key=True),
    Column("model_id", NAME, nullable=False),
    Column("model_version", NAME, nullable=False),
    Column("particles", Integer, nullable=False),
    Column("seed", BIG, nullable=False),
    Column("head_seq", BIG, nullable=False),
    Column("digest", String(64), nullable=False),
    Column("created_at", Double, nullable=False),
    Column("network", Text),
    Column("origin", NAME),
    Column("adopt", String(20), nullable=False, server_default="never"),
    Column("diagnose", String(20), nullable=False, server_default="never"),
    Column("adopt_now", String(20)),
    Column("diagnose_now", String(20)),
    Column("policy_at", Double),
    Column("policy_digest", String(64)),
    ForeignKeyConstraint(["model_id", "model_version"], ["model.id", "model.version"]),
)

blade = Table(
    "blade",
    metadata,
    Column("rotor_id", NAME, ForeignKey("rotor.id"), primary_key=True),
    Column("id", NAME, primary_key=True),
    Column("slot", NAME),
    Column("lot", NAME),
    Column("coating_lot", NAME),
    Column("installed_at", NAME),
    Column("time_h0", Double),
    Column("added_seq", BIG, nullable=False),
    Column("retired_seq", BIG),
    Column("known", Text),
)

entry = Table(
    "event",
    metadata,
    Column("rotor_id", NAME, ForeignKey("rotor.id"), primary_key=True),
    Column("seq", BIG, primary_key=True, autoincrement=False),
    Column("event_id", String(240), nullable=False),
    Column("kind", String(20), nullable=False),
    Column("replaces", NAME),
    Column("blade", NAME),
    Column("time_h", Double),
    Column("body", Text, nullable=False),
    Column("digest", String(64), nullable=False),
    Column("received_at", Double, nullable=False),
    Column("posted_by", String(40)),
    Column("traceparent", String(60)),
    UniqueConstraint("rotor_id", "event_id"),
    Index("ix_event_rotor_id_replaces", "rotor_id", "replaces"),
    Index("ix_event_received", "rotor_id", "received_at", "seq"),
    Index("ix_event_rotor_id_kind_seq", "rotor_id", "kind", "seq"),
    Index("ix_event_rotor_id_blade_kind_seq", "rotor_id", "blade", "kind", "seq"),
)

cursor = Table(
    "cursor",
    metadata,
    Column("rotor_id", NAME, ForeignKey("rotor.id"), primary_key=True),
    Column("applied_seq", BIG, nullable=False),
    Column("version", BIG, nullable=False),
    Column("dirty", Boolean, nullable=False),
    Column("dirty_since", Double),
    Column("provisional_since", Double),
    Column("fence", BIG, nullable=False),
    Column("owner", NAME),
    Column("lease_until", Double),
    Column("sealing", Boolean, nullable=False),
    Column("not_before", Double),
    Column("attempts", Integer, nullable=False),
    Column("blocked", Boolean, nullable=False),
    Column("last_error", Text),
    Column("last_error_event", NAME),
    Column("takeovers", BIG, nullable=False, server_default="0"),
    Column("seals", BIG, nullable=False, server_default="0"),
    Column("ess_ratio", Double),
    Column("outbox_dropped", BIG, nullable=False, server_default="0"),
    Index("ix_cursor_dirty_dirty_since", "dirty", "dirty_since"),
)

state = Table(
    "state",
    metadata,
    Column("rotor_id", NAME, ForeignKey("rotor.id"), primary_key=True),
    Column("version", BIG, primary_key=True, autoincrement=False),
    Column("through_seq", BIG, nullable=False),
    Column("model_id", NAME, nullable=False),
    Column("model_version", NAME, nullable=False),
    Column("algorithm_version", NAME, nullable=False),
    Column("sealed", Boolean, nullable=False),
    Column("digest", String(64), nullable=False),
    Column("events_digest", String(64), nullable=False),
    Column("meta", Text, nullable=False),
    Column("created_at", Double, nullable=False),
)

state_array = Table(
    "state_array",
    metadata,
    Column("rotor_id", NAME, ForeignKey("rotor.id"), primary_key=True),
    Column("name", NAME, primary_key=True),
    Column("version", BIG, primary_key=True, autoincrement=False),
    Column("encoding", String(20), nullable=False),
    Column("dtype", String(20), nullable=False),
    Column("shape", String(100), nullable=False),
    Column("sha256", String(64), nullable=False),
    Column("data", LargeBinary, nullable=False),
    # what a version is made of is read without touching its bytes
    Index("ix_state_array_digests", "rotor_id", "name", "version", "sha256"),
)

outbox = Table(
    "outbox",
    metadata,
    Column("id", BIG, primary_key=True, autoincrement=True),
    Column("rotor_id", NAME, ForeignKey("rotor.id"), nullable=False),
    Column("kind", String(20), nullable=False),
    Column("payload", Text, nullable=False),
    Column("at", Double, nullable=False),
    Index("ix_outbox_rotor_id_id", "rotor_id", "id"),
)

residual = Table(
    "residual",
    metadata,
    Column("rotor_id", NAME, ForeignKey("rotor.id"), primary_key=True),
    Column("version", BIG, nullable=False),
    Column("body", Text),
    Column("alarms", Integer, nullable=False),
    Column("computed_at", Double),
    Column("fence", BIG, nullable=False),
    Column("owner", NAME),
    Column("lease_until", Double),
    Column("not_before", Double),
    Column("attempts", Integer, nullable=False),
    Column("error", Text),
    Column("judged", BIG, nullable=False, server_default="0"),
    Column("asked", Text),
)

blob = Table(
    "blob",
    metadata,
    Column("sha256", String(64), primary_key=True),
    Column("part", Integer, primary_key=True, autoincrement=False),
    Column("data", LargeBinary, nullable=False),
)

# Array bytes do not compress; PostgreSQL need not try.
EXTERNAL_STORAGE = "ALTER TABLE state_array ALTER COLUMN data SET STORAGE EXTERNAL"
_external = DDL(EXTERNAL_STORAGE)  # type: ignore[no-untyped-call]
event.listen(state_array, "after_create", _external.execute_if(dialect="postgresql"))
_external = DDL("ALTER TABLE blob ALTER COLUMN data SET STORAGE EXTERNAL")  # type: ignore[no-untyped-call]
event.listen(blob, "after_create", _external.execute_if(dialect="postgresql"))
