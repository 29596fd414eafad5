"""The chaos study, short: nothing lost, nothing applied twice; and it notices a service that does.

In full: `bladetwin study chaos`; results in tests/claims/results/chaos.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from service.studies.chaos import chaos, traffic
from service.studies.chaos.processes import forked
from tests.chaos import mutants

SEED = 20310504
PLAN = chaos.Plan(traffic.make(3, 240, 4, SEED), kills=8, clients=4, seed=SEED)


def shown(done: int) -> None:
    """No progress in a test."""


@pytest.fixture(scope="module")
def calm(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The digests of the plan undisturbed: the same for every database."""
    return chaos.undisturbed(PLAN, f"sqlite:///{tmp_path_factory.mktemp('calm') / 'calm.db'}")


def test_nothing_is_lost_or_applied_twice_while_everything_is_killed(
    database_url: str, calm: dict[str, str]
) -> None:
    found, ledger, facts = chaos.disturbed(PLAN, database_url, shown)
    assert facts["kills_in_all"] == 8
    assert ledger.breaches == []
    assert found.faults == {}
    assert ledger.readings == 240
    assert found.counts["entries"] > 240, "retractions are entries as well"
    assert len(calm) == 3
    assert found.digests == calm


@pytest.mark.parametrize(
    ("mutant", "share_of_api", "noticed"),
    [
        ("acknowledged_early", 1.0, "lost"),
        ("repetition_not_known", 0.0, "breach"),
    ],
)
def test_a_broken_rule_is_noticed(
    mutant: str, share_of_api: float, noticed: str, tmp_path: Path
) -> None:
    """Negative controls: the same study of services with one rule taken away."""
    small = traffic.make(1, 160, 4, SEED)
    assert any(batch.twice for batch in small.batches)
    plan = chaos.Plan(small, 3, 6, SEED, settle_s=3.0, share_of_api=share_of_api)
    url = f"sqlite:///{tmp_path / 'mutant.db'}"
    found, ledger, _ = chaos.disturbed(plan, url, shown, forked(mutants.main, mutant))
    seen = set(found.faults) | ({"breach"} if ledger.breaches else set())
    assert noticed in seen, found.to_json()
