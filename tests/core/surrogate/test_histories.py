"""Many histories at once, each between hours of its own: as each of them by itself."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from core.builtin import rotor_blade
from core.errors import InputError
from core.surrogate import history
from core.surrogate.followed import Followed
from core.surrogate.histories import follow_each

BLADE = rotor_blade.load()
RNG = np.random.default_rng(0)
NAN = float("nan")
TIP = BLADE.named["tip"]
EDGES = np.array([[0.0, NAN, NAN], [0.0, 1.2e4, NAN], [0.0, 3e3, 2.1e4], [0.0, 7e3, 9e3]])
MARKS = np.array([[5e3, 2e4, 4e4], [1.2e4, 3e4, NAN], [3e4, NAN, NAN], [NAN, 8e3, 5e4]])
X = BLADE.low + RNG.random((4, 5, 4)) * (BLADE.high - BLADE.low)
X[:, :, 1] = np.clip(X[:, :, 1], 0.85, 0.95)
ROWS = [Followed.of(BLADE, "elongation", None), Followed.of(BLADE, "ceeq", [TIP])]
ROWS.append(Followed.mixed(BLADE, np.eye(3, BLADE.deformation_modes([TIP]).shape[2])))


def alone(i: int, *, late: bool) -> list[np.ndarray]:
    """Of one history, by the rule for those that share their hours."""
    edges, there = EDGES[i][~np.isnan(EDGES[i])], ~np.isnan(MARKS[i])
    pieces, at = X[[i], : len(edges) - 1], X[[i], 2:][:, there]
    found = history.follow(BLADE, edges, pieces, MARKS[i][there], at, ROWS, doubt=False, late=late)
    return [mean[0] for mean, _, _ in found]


@pytest.mark.parametrize("late", [True, False])
def test_each_is_as_it_is_by_itself(late: bool) -> None:
    together = follow_each(BLADE, EDGES, X[:, :2], MARKS, X[:, 2:], ROWS, late=late)
    for i in range(len(MARKS)):
        there = ~np.isnan(MARKS[i])
        for mine, own in zip(together, alone(i, late=late), strict=True):
            assert mine[i][there] == pytest.approx(own, rel=1e-9)
            assert np.all(np.isnan(mine[i][~there])), "nothing is made up"


def test_the_process_is_asked_for_what_is_read_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Four histories, eight marks, and the three edges that lie on the way to one."""
    asked, known = [], history.Walk.known

    def counted(self: Any, x: np.ndarray) -> Any:
        asked.append(len(x))
        return known(self, x)

    monkeypatch.setattr(history.Walk, "known", counted)
    follow_each(BLADE, EDGES, X[:, :2], MARKS, X[:, 2:], ROWS, late=True)
    ways = [
        np.sum(e[1:, None] < m[None, :], axis=0).max() for e, m in zip(EDGES, MARKS, strict=True)
    ]
    assert ways == [0, 1, 2, 2]
    assert sum(asked) == np.sum(~np.isnan(MARKS)) + sum(ways)


@pytest.mark.parametrize(
    ("edges", "marks"),
    [
        (EDGES + 1.0, MARKS),
        (EDGES[:, [0, 2, 1]] * [1.0, 1.0, 0.1], MARKS),
        (EDGES[:, :2], MARKS),
        (EDGES, MARKS - 5e3),
        (EDGES, MARKS[:, :2]),
    ],
)
def test_hours_that_do_not_fit_are_refused(edges: np.ndarray, marks: np.ndarray) -> None:
    with pytest.raises(InputError, match="do not fit"):
        follow_each(BLADE, edges, X[:, :2], marks, X[:, 2:], ROWS)
