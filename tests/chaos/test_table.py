"""The table of mutants names tests that exist."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
TABLE = ROOT / "tests/claims/results/chaos/mutants.md"


def missing(text: str) -> list[str]:
    """Tests that are named and not there."""
    named = re.findall(r"`(tests/\S+\.py)::(test_\w+)`", text)
    assert named
    return [test for file, test in named if f"def {test}(" not in (ROOT / file).read_text()]


def test_every_test_of_the_table_exists() -> None:
    assert missing(TABLE.read_text()) == []
    gone = "`tests/chaos/test_table.py::test_that_was_renamed`"
    assert missing(gone) == ["test_that_was_renamed"]
