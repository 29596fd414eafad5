"""What the README of this folder says of the kept studies, one after the other.

The table of all figures at its top is left out: a study is told in words, not by that alone.
"""

from __future__ import annotations

from pathlib import Path

_BEFORE, _, _REST = Path(__file__).with_name("README.md").read_text().partition("## All figures\n")
FIGURES, _, _WORDS = _REST.partition("\n## ")
WORDS = f"{_BEFORE}## {_WORDS}"
