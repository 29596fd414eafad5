"""What is wrong with a user's runs, and what to mind.

All of it is collected before anything is refused, so that one look is enough. A finding names the
run by its label, the quantity, the hour and the node; it is an `InputError` at heart (what, value,
problem, remedy), which the service answers with as a problem's fault.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from core.errors import FaultsError, InputError

MOST = 200  # findings of one kind that are listed


class RunsError(FaultsError):
    """Runs that cannot be used; `faults` has all of it, `warnings` what else to mind."""

    def __init__(self, faults: Sequence[InputError], warnings: Sequence[InputError] = ()) -> None:
        self.warnings = tuple(warnings)
        super().__init__(faults)


@dataclass(slots=True)
class Findings:
    """Faults and warnings as they are found.

    >>> found = Findings()
    >>> found.fault("run 2: drop", -1.0, "is negative", "repeat the run")
    >>> found.end()
    Traceback (most recent call last):
    core.archive.faults.RunsError: run 2: drop = -1.0 is negative. To mend it: repeat the run.
    """

    faults: list[InputError] = field(default_factory=list)
    warnings: list[InputError] = field(default_factory=list)

    def fault(self, what: str, value: object, problem: str, remedy: str) -> None:
        self.add(InputError(what, value, problem, remedy))

    def add(self, error: InputError) -> None:
        self.faults.append(error)

    def warn(self, what: str, value: object, problem: str, remedy: str) -> None:
        self.warnings.append(InputError(what, value, problem, remedy))

    def end(self) -> None:
        """Raise RunsError where anything was refused."""
        if len(self.faults) > MOST:
            left = len(self.faults) - MOST
            more = InputError("faults", left, "more are not listed", "mend the first ones")
            self.faults[MOST:] = [more]
        if self.faults:
            raise RunsError(self.faults, self.warnings)
