"""Workers: processes that turn the log into posteriors.

    claiming.py   who may take a rotor, and when
    clock.py      when a lease or a pause is over, by the database's clock
    lease.py      heartbeat, commit, failure: the fenced moves of a cursor
    task.py       what one update rests on: entries, and the state before them
    update.py     one rotor's pending entries become one new version
    new_version.py its arrays, its row and the cursor, committed together
    culprit.py    which entry stops a rotor
    replay.py     a posterior from the log alone, compared with what is stored
    rebuild.py    and mended by it
    interrupt.py  a worker that is told to end ends what it computes
    job_lease.py  claim, heartbeat, progress, end: the fenced moves of a job
    jobs.py       work that answers later: the registration or training of a model, a diagnosis
    training.py   runs that were uploaded become a model
    diagnosing.py what a diagnosis rests on, and its result as data
    deliver.py    sends what webhooks are to be told
    hook_lease.py claim and fence of a webhook
    wake.py       how a sleeping worker or reader learns of a commit
    loop.py       the life of one worker process
    supervise.py  `serve` starts workers, restarts a dead one and leaves no orphan

The guarantee: every entry of a rotor's log is applied to its posterior exactly once, in the same
transaction that moves the rotor's cursor past it, by a worker whose fence still holds.
"""
