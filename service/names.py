"""What ids, texts and numbers may look like, in requests and in files."""

from __future__ import annotations

import re

ID_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9._:@+\-]*$"
ID_LENGTH = 100
TEXT_PATTERN = r"^[^\x00-\x1f\x7f]+$"
_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?")
LONGEST_NUMBER = 40


def is_number(text: str) -> bool:
    """Whether a text is a decimal number, of 40 characters at most.

    >>> [is_number(text) for text in ("-2.5e4", ".5", "1_000", "nan", "1" * 41)]
    [True, True, False, False, False]
    """
    return len(text) <= LONGEST_NUMBER and _NUMBER.fullmatch(text) is not None
