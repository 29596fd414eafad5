"""What a rotor does by itself, decided anew while it is in service.

A rotor is created with options: whether it asks for diagnoses, and whether what they name is
adopted. Whoever operates it may change his mind, and has to be able to stop it: an effect that
enters a model moves every prediction. The options of the creation stay in its row, for its digest
was made from them; the policy in force stands beside them with a digest of its own.

No entry of the log is made, since no posterior rests on it: what was adopted stays until somebody
backs it out. A diagnosis that is under way is judged, when it ends, by the policy of that moment.
Residuals that stand are judged again, so that a rotor which asks from now on does not wait for
another reading.
"""

from __future__ import annotations

from service.digests import policy_problem
from service.errors import DamagedRotorError
from service.ports import Adopt, Diagnose, RotorRecord, Store


def decide(
    store: Store, rotor_id: str, adopt: Adopt | None, diagnose: Diagnose | None
) -> RotorRecord:
    """The rotor under its new policy; an option that is None stays as it is.

    DamagedRotorError: what it does now is not what was written, and one of the two would be kept.
    """
    with store.write() as tx:
        tx.log.lock(rotor_id)
        rotor = tx.records.rotor(rotor_id)
        now = (adopt or rotor.adopts, diagnose or rotor.asks)
        problem = policy_problem(rotor)
        if problem is not None and None in (adopt, diagnose):
            raise DamagedRotorError(rotor_id, [f"rotor {rotor_id}: {problem}"])
        if problem is not None or now != (rotor.adopts, rotor.asks):
            tx.records.put_policy(rotor_id, *now)
        return tx.records.rotor(rotor_id)
