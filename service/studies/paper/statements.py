"""What the paper says of its example, held against our numbers.

A statement has the paper's words, the rule by which they are judged, and a function from numbers
(`numbers.told`, by case) to a verdict and a sentence (`judges`). The same function on other numbers
gives another verdict: nothing is written by hand. The rules were fixed before the numbers were
there, but for one: what of theta is not identifiable was asked of the correlation first and, after
a look at eight blades, of the combination that the data tell least (`core/decisions.md`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from service.studies.paper.judges import (
    Json,
    Verdict,
    accuracy_with_delta,
    best_regressor,
    good_surrogate,
    not_identifiable,
    offline_sharper,
    online_cheaper,
    scan_improved,
    sharper_with_delta,
    some_sharper_without,
    too_narrow_online,
    wider_with_delta,
    within_bounds,
)


@dataclass(frozen=True, slots=True)
class Statement:
    """One of the paper's: where, in which words, and when we say that it holds here."""

    where: str
    figures: tuple[int, ...]
    quote: str
    rule: str
    judge: Callable[[Json], tuple[Verdict, str]]


@dataclass(frozen=True, slots=True)
class Judged:
    """A statement beside ours."""

    statement: Statement
    verdict: Verdict
    ours: str

    def to_json(self) -> dict[str, Any]:
        s = self.statement
        return {
            "where": s.where,
            "quote": s.quote,
            "rule": s.rule,
            "verdict": self.verdict,
            "ours": self.ours,
        }


def judged(found: Json) -> list[Judged]:
    """All statements against the numbers `found`: {"cases": {name: stages}, "surrogate", …}."""
    return [Judged(s, *s.judge(found)) for s in STATEMENTS]


STATEMENTS = (
    Statement(
        "Sec. 4.2",
        (),
        "Extra-Trees regressor was found to give the best results for this problem",
        "agrees if extra trees have the least median error in the contest at the model's making",
        best_regressor,
    ),
    Statement(
        "Sec. 4.2",
        (3,),
        "The R² value of the predictions on the test set in the low-dimensional space is 0.97",
        "agrees if R² at unseen finite elements is 0.97 or more, for CEEQ and elongation",
        good_surrogate,
    ),
    Statement(
        "Sec. 4.3",
        (6, 8),
        "it may be difficult to distinguish between the effects of the model parameters and model "
        "discrepancy",
        "agrees if a combination of θ1 and θ2 keeps nine tenths of its prior's sd",
        not_identifiable,
    ),
    Statement(
        "Sec. 4.3",
        (7, 8),
        "the inclusion of model discrepancy results in slightly sharper posterior distributions",
        "agrees if some of the four sds are 3 % smaller and none 3 % larger; in part if some are "
        "smaller and others larger",
        sharper_with_delta,
    ),
    Statement(
        "Sec. 4.3",
        (9, 10),
        "The measurements at each time step are observed to be within the prediction bounds",
        "agrees if all elongations and 95 % of the deformations lie within ±1 sd; in part if the "
        "bounds hold what they promise (elongations within 2.5 sd, 90 % of deformations in 95 %)",
        within_bounds,
    ),
    Statement(
        "Sec. 4.3",
        (10,),
        "The surrogate model predictions for 3D deformation are improved with the inclusion of δ",
        "agrees if the error falls by 1 % at the scans that were read and at the held-out one",
        scan_improved,
    ),
    Statement(
        "Sec. 4.3",
        (15,),
        "the accuracy of including a model discrepancy term is actually better than without",
        "agrees if the error falls by 1 % for blade 90 and for all held-out readings",
        accuracy_with_delta,
    ),
    Statement(
        "Sec. 4.3",
        (15,),
        "the uncertainty increases with the inclusion of model discrepancy",
        "agrees if the sd of blade 90's elongation grows by more than 3 %",
        wider_with_delta,
    ),
    Statement(
        "Sec. 4.3",
        (7, 8, 13, 14),
        "the posterior distributions obtained using the offline strategy are significantly sharper",
        "agrees if all sds of blade 01 are 3 % smaller offline; in part if some are",
        offline_sharper,
    ),
    Statement(
        "Sec. 4.3",
        (13,),
        "some of the posterior distributions without δ are sharper than those with δ",
        "agrees if one of the four sds is 3 % smaller without δ",
        some_sharper_without,
    ),
    Statement(
        "Sec. 4.3",
        (16,),
        "the uncertainty was not adequately quantified for some of the online calibration cases",
        "agrees if 95 % bounds of a coming scan hold less than 90 % of it at some outage",
        too_narrow_online,
    ),
    Statement(
        "Sec. 4.3",
        (),
        "online calibration can identify any changes in real-time, and is computationally less "
        "demanding",
        "agrees if the online calibrations take less processor time than the offline ones",
        online_cheaper,
    ),
)
