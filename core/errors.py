"""The errors of bladetwin, as a tree.

::

    BladetwinError
    ├── InputError          a value that cannot be used: what, value, remedy
    │   ├── UnitError       a unit that does not fit the quantity
    │   └── RangeError      a number outside what the model covers
    ├── FaultsError         one or more faults, each an InputError
    ├── ModelError          a model, archive or artefact that is missing or damaged
    └── CalibrationError    an update that has no trustworthy answer

Every error says what is wrong, which value, the numbers and what to do, and carries them as
fields, so that a caller can show or act on them without reading the sentence.
"""

from __future__ import annotations

import math
from collections.abc import Sequence


class BladetwinError(Exception):
    """Root of the tree. Catch this to catch everything bladetwin raises on purpose."""


class InputError(BladetwinError):
    """A value that cannot be used.

    what     name of the input, as the caller wrote it (``"inspections[3].time_h"``)
    value    the offending value
    remedy   what to do about it

    >>> try:
    ...     raise InputError("t1t_rate", 1.2, "lies outside 0.8 … 1.0", "give a fraction")
    ... except InputError as error:
    ...     print(error)
    t1t_rate = 1.2 lies outside 0.8 … 1.0. To mend it: give a fraction.
    """

    def __init__(self, what: str, value: object, problem: str, remedy: str) -> None:
        self.what = what
        self.value = value
        self.problem = problem
        self.remedy = remedy
        super().__init__(f"{what} = {value!r} {problem}. To mend it: {remedy}.")

    def to_json(self) -> dict[str, object]:
        """Plain data: field, value, problem, remedy; what JSON cannot hold becomes a text.

        >>> InputError("x", float("nan"), "is no number", "give one").to_json()["value"]
        'nan'
        """
        value = self.value
        plain = value is None or isinstance(value, str | bool | int)
        plain |= isinstance(value, float) and math.isfinite(value)
        told = {"field": self.what, "value": value if plain else repr(value)}
        return told | {"problem": self.problem, "remedy": self.remedy}


class UnitError(InputError):
    """A unit that does not fit the quantity."""


class RangeError(InputError):
    """A number outside what the model covers."""


class FaultsError(BladetwinError):
    """Something that cannot be used; `faults` names every field, value and remedy."""

    def __init__(self, faults: Sequence[InputError]) -> None:
        self.faults = tuple(faults)
        super().__init__("; ".join(map(str, faults)))


class ModelError(BladetwinError):
    """A model, archive or artefact that is missing, damaged or of another schema."""


class CalibrationError(BladetwinError):
    """An update that has no trustworthy answer; `event` names the inspection where known."""

    def __init__(self, message: str, *, event: str | None = None) -> None:
        self.event = event
        super().__init__(message)
