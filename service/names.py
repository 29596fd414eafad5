"""What ids, texts and numbers may look like, in requests and in files."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable

ID_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9._:@+\-]*$"
ID_LENGTH = 100
TEXT_PATTERN = r"^[^\x00-\x1f\x7f]+$"
_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?")
TITLE_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9 _+\-]*$"
LONGEST_NUMBER = 40


def is_number(text: str) -> bool:
    """Whether a text is a decimal number, of 40 characters at most.

    >>> [is_number(text) for text in ("-2.5e4", ".5", "1_000", "nan", "1" * 41)]
    [True, True, False, False, False]
    """
    return len(text) <= LONGEST_NUMBER and _NUMBER.fullmatch(text) is not None


def listed(labels: Iterable[str]) -> str:
    """Labels in one text, with commas between; one with a comma or a quote in it is quoted.

    >>> listed(["7", "load 1,2", "9"])
    '7,"load 1,2",9'
    """
    out = io.StringIO()
    csv.writer(out, lineterminator="").writerow(labels)
    return out.getvalue()


def unlisted(text: str) -> tuple[str, ...]:
    """The inverse of `listed`; blanks around a label are none of it.

    >>> unlisted(listed(["7", "load 1,2", 'bore 5"'])), unlisted(' 2, 7,, "load 1,2" ')
    (('7', 'load 1,2', 'bore 5"'), ('2', '7', 'load 1,2'))
    """
    rows = csv.reader(io.StringIO(text, newline=""), skipinitialspace=True)
    return tuple(label for row in rows for one in row if (label := one.strip()))
