"""Where everything is kept: one relational database, SQLite or PostgreSQL, one code path.

schema.py    what tables are declared in      tables.py   models, rotors, logs, posteriors, jobs
access_tables.py   who calls                  hook_tables.py   who is told
engine.py    connections and transactions
encoding.py  arrays as checked .npy bytes     log.py      the inspection log, which is the queue
kept.py      versions of a rotor's posterior  states.py   their arrays
versions.py  written, and thinned when old    records.py  rotors, blades
models.py    models                           jobs.py     jobs
keys.py      API keys                         trail.py     the audit trail
answers.py   first answers by Idempotency-Key
cache.py     what a process keeps          intact.py   whether a version is what was written
audit.py     every stored part checked    outbox.py   notes of what was committed
gathered.py  many rows fetched as one
unit_of_work.py   one transaction with all of these
"""
