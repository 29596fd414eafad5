from __future__ import annotations

import pytest

from core.archive import Archive
from core.errors import ModelError
from core.surrogate.contest import contest, contestants


@pytest.fixture(scope="module")
def table(archive: Archive) -> dict[str, dict[str, str | float]]:
    return {str(row["name"]): row for row in contest(archive, range(66), seed=2)}


def test_the_process_wins_and_the_trees_of_the_published_method_are_ten_times_worse(
    table: dict[str, dict[str, str | float]],
) -> None:
    assert next(iter(table)) == "gaussian process"
    best, trees = (float(table[n]["p95_percent"]) for n in ("gaussian process", "extra trees"))
    assert best < 2.5
    assert trees > 10 * best


def test_rows_are_sorted_by_their_95th_percentile(
    table: dict[str, dict[str, str | float]],
) -> None:
    errors = [float(row["p95_percent"]) for row in table.values()]
    assert errors == sorted(errors)
    assert len(errors) == 5


def test_polynomials_that_the_runs_cannot_carry_stay_out() -> None:
    assert "cubic" in contestants(35, 4, seed=1)
    assert "cubic" not in contestants(34, 4, seed=1)
    assert "quadratic" in contestants(34, 4, seed=1)


def test_a_field_and_a_curve_that_is_not_positive_are_refused(archive: Archive) -> None:
    with pytest.raises(ModelError, match="positive from 1000 h on"):
        contest(archive, range(66), quantity="mises")
