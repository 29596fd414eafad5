"""The contest's result in Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

Json = Mapping[str, Any]
HEAD = (
    "| regressor | targets | RMSE | R² | RMSE, each | R², each | tip, median % | tip, 95th % "
    "| deformation, µm | CEEQ, median % | CEEQ, 95th % |"
)
COLUMNS = (
    ("rmse_by_variance", 1.0),
    ("r2_by_variance", 1.0),
    ("rmse_each", 1.0),
    ("r2_each", 1.0),
    ("tip_median_percent", 1.0),
    ("tip_p95_percent", 1.0),
    ("field_rmse_mm", 1000.0),
    ("ceeq_median_percent", 1.0),
    ("ceeq_p95_percent", 1.0),
)


def markdown(found: Json) -> str:
    """The whole result as one page."""
    archive, plan, paper = found["archive"], found["plan"], found["paper"]
    rows: Sequence[Json] = found["rows"]
    out = [
        "# The contest of surrogates",
        "",
        f"`{found['command']}`, seed {found['seed']}: {archive['training']} training and "
        f"{archive['independent']} independent runs, {archive['nodes']} nodes (mesh "
        f"{archive['mesh']}), fields compared at {min(plan['nodes'], archive['nodes'])} of them. "
        f"Every contestant predicts the same features, {plan['features']} at most; it tries "
        f"{plan['configurations']} configurations by the same rule in {plan['inner']}-fold "
        "cross-validation within the training runs of each fold.",
        "",
        f"First, by the rule set beforehand ({found['rule']}): **{found['best']['name']}**, "
        f"{found['best']['targets']} targets.",
    ]
    if found["not_installed"]:
        out += ["", f"Not installed, and therefore left out: {', '.join(found['not_installed'])}."]
    for title, key in (
        (f"{plan['folds']}-fold cross-validation", "cross_validation"),
        ("Independent runs", "independent"),
    ):
        out += ["", f"## {title}", "", HEAD, "|---|---" + "|--:" * len(COLUMNS) + "|"]
        out += [_line(row, row[key]) for row in rows]
    out += [
        "",
        "RMSE and R² are of the leading 20 features, by variance and each alike; the mean of the "
        "runs has RMSE 1. Tip elongation and CEEQ at each run's worst node from 1000 h on. The "
        "last rows are controls; the features themselves are what the reduction alone leaves.",
        "",
        "## Speed and size",
        "",
        "| regressor | targets | s per million | regressor, MB | with bases, MB | configuration |",
        "|---|---|--:|--:|--:|---|",
        *(_cost(row) for row in rows if row["seconds_per_million"] is not None),
        "",
        "Seconds of one processor for the tip elongation at the last instant, from inputs to mm.",
        "",
        "## Beside the published finding",
        "",
        "| | published (Sec. 4.2) | here, raw targets | here, best |",
        "|---|---|---|---|",
        *_beside(rows, paper),
        "",
    ]
    return "\n".join(out)


def number(value: float) -> str:
    """Three digits.

    >>> [number(v) for v in (0.99876, 0.012345, 12.345, 1234.5, -0.5)]
    ['0.999', '0.0123', '12.3', '1234', '-0.5']
    """
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.3g}"


def _line(row: Json, told: Json) -> str:
    cells = [told_as(name, scale * told[name]) for name, scale in COLUMNS]
    return f"| {row['name']} | {row['targets']} | " + " | ".join(cells) + " |"


def told_as(name: str, value: float) -> str:
    """R² with four decimals, everything else with three digits.

    >>> told_as("r2_each", 0.99876), told_as("rmse_each", 0.99876)
    ('0.9988', '0.999')
    """
    return f"{value:.4f}" if name.startswith("r2") else number(value)


def _cost(row: Json) -> str:
    own, shared = row["regressor_bytes"] / 1e6, row["shared_bytes"] / 1e6
    setting = ", ".join(f"{k} {_short(v)}" for k, v in row["setting"].items()) or "–"
    cells = [row["name"], row["targets"], number(row["seconds_per_million"])]
    return f"| {' | '.join(cells)} | {number(own)} | {number(own + shared)} | {setting} |"


def _short(value: Any) -> str:
    if isinstance(value, list):
        return " ".join(number(one) for one in value)
    return {True: "yes", False: "no"}[value] if isinstance(value, bool) else f"{value}"


def _beside(rows: Sequence[Json], paper: Json) -> list[str]:
    own = [row for row in rows if not row["control"]]
    raw = [row for row in own if row["targets"] == "raw"]

    def by(some: Sequence[Json]) -> list[Json]:
        return sorted(some, key=lambda row: float(row["cross_validation"]["rmse_by_variance"]))

    trees = {row["targets"]: row for row in own if row["name"] == paper["first"]}
    order, best = by(raw), own[0]
    lines = [
        f"| first by RMSE of the features | {paper['first']} | "
        f"{order[0]['name'] if order else '–'} | {best['name']} |",
        f"| its cross-validated RMSE | {paper['cv_rmse']} | "
        f"{_of(order[:1], 'rmse_by_variance')} | {_of([best], 'rmse_by_variance')} |",
        f"| its R² on independent runs | {paper['r2_test']} | "
        f"{_of(order[:1], 'r2_by_variance', 'independent')} | "
        f"{_of([best], 'r2_by_variance', 'independent')} |",
    ]
    if trees:
        some = [[trees[k]] if k in trees else [] for k in ("raw", "transformed")]
        lines += [
            f"| {paper['first']}: RMSE | {paper['cv_rmse']} | {_of(some[0], 'rmse_by_variance')} | "
            f"{_of(some[1], 'rmse_by_variance')} (transformed) |",
            f"| {paper['first']}: R² | {paper['r2_test']} | "
            f"{_of(some[0], 'r2_by_variance', 'independent')} | "
            f"{_of(some[1], 'r2_by_variance', 'independent')} (transformed) |",
        ]
    return lines


def _of(rows: Sequence[Json], name: str, key: str = "cross_validation") -> str:
    return told_as(name, rows[0][key][name]) if rows else "–"
