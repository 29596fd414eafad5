"""The errors of the service, beside those of the science.

::

    BladetwinError
    ├── InputError …          (core.errors)
    ├── FaultsError           (core.errors) a request or an archive with one or more faults
    ├── NotFoundError         something that the address or body names does not exist
    ├── ConflictError         the same id with another content, or of a blade that has left
    ├── NotYetError           an answer that a worker has yet to compute
    ├── GoneError             a version that is no longer kept
    ├── AdoptionError         an effect that cannot go into a rotor's model, or out of it, as it is
    ├── PreconditionError     what a change depends on is not as the caller saw it
    ├── KeysMissingError      a server that would refuse every request
    ├── DamagedError          a stored part that is not what was written
    ├── DamagedLogError       an entry of the log that is not what was written
    ├── DamagedRotorError     a rotor of which nothing is computed: what it rests on is damaged
    ├── WebhooksOffError      webhooks without the key file that their secrets are made of
    ├── NotInstalledError     a format whose library is not installed here
    ├── HeldError             a rotor that a worker holds at the moment
    ├── BackupError           a backup that is not made, or not restored
    ├── SchemaError           a database whose schema is not that of this release
    ├── LostLeaseError        a worker whose rotor another one has taken
    └── StoreAwayError        the database does not answer; nothing was written
"""

from __future__ import annotations

from collections.abc import Sequence

from core.errors import BladetwinError
from core.errors import FaultsError as FaultsError

MOST_FAULTS = 1000  # that one answer tells; who looks for them stops a little later


class NotFoundError(BladetwinError):
    """`what` (a noun) called `name` does not exist."""

    def __init__(self, what: str, name: str, remedy: str) -> None:
        self.what = what
        self.name = name
        self.remedy = remedy
        super().__init__(f"{what} {name!r} does not exist. To mend it: {remedy}.")


class ConflictError(BladetwinError):
    """`what` called `name` (or several of them) exists with another content, is given twice with
    different content, or has left."""

    def __init__(
        self, what: str, name: str, remedy: str, problem: str = "exists with another content"
    ) -> None:
        self.what = what
        self.name = name
        self.problem = problem
        self.remedy = remedy
        super().__init__(f"{what} {name!r} {problem}. To mend it: {remedy}.")


class NotYetError(BladetwinError):
    """The answer is being computed; ask again later."""

    def __init__(self, what: str, remedy: str) -> None:
        self.what = what
        self.remedy = remedy
        super().__init__(f"{what} is not computed yet. To mend it: {remedy}.")


class GoneError(BladetwinError):
    """A version that was thinned out; `kept` names the nearest that are kept, with their ends.

    field   what asked for it: ``version`` or ``at``
    kept    (version, through_seq) before it, then after it, where there is one
    """

    def __init__(
        self, what: str, field: str, value: object, kept: tuple[tuple[int, int], ...]
    ) -> None:
        self.what = what
        self.field = field
        self.value = value
        self.kept = kept
        near = " or ".join(f"version {v} (through entry {seq})" for v, seq in kept)
        self.remedy = (
            f"ask for {near}, the nearest that are kept; BLADETWIN_KEEP_VERSIONS keeps more"
        )
        super().__init__(f"{what} is no longer kept. To mend it: {self.remedy}.")


class AdoptionError(BladetwinError):
    """A diagnosis that cannot be adopted or backed out as things stand; nothing was changed."""

    def __init__(self, diagnosis: str, verb: str, problem: str, remedy: str) -> None:
        self.diagnosis = diagnosis
        self.problem = problem
        self.remedy = remedy
        super().__init__(
            f"diagnosis {diagnosis} cannot be {verb}: {problem}; nothing was changed. "
            f"To mend it: {remedy}."
        )


class DamagedError(BladetwinError):
    """A stored part of a version that is not what was written; it is never used.

    part   ``state`` or ``array <name>``
    """

    def __init__(self, rotor: str, version: int, part: str, problem: str) -> None:
        self.rotor = rotor
        self.version = version
        self.part = part
        self.problem = problem
        self.remedy = f"run `bladetwin verify {rotor} --repair`, which rebuilds it from the log"
        super().__init__(
            f"version {version} of rotor {rotor} is damaged: {part}: {problem}. "
            f"To mend it: {self.remedy}."
        )


class DamagedLogError(BladetwinError):
    """An entry of a rotor's log that is not what was written, or is missing."""

    def __init__(self, rotor: str, entry: str, problem: str) -> None:
        self.rotor = rotor
        self.entry = entry
        self.problem = problem
        super().__init__(
            f"the log of rotor {rotor} is damaged: {entry}: {problem}. To mend it: restore the "
            "database, or import the rotor from a file that was exported before."
        )


class DamagedRotorError(BladetwinError):
    """What a rotor's versions are computed from is not what was written; none is computed."""

    def __init__(self, rotor: str, problems: Sequence[str]) -> None:
        self.rotor = rotor
        self.problems = tuple(problems)
        self.remedy = (
            "restore the database, or import the rotor from a file that was exported before"
        )
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        super().__init__(
            f"{problems[0]}{more}. The log cannot make it again; nothing was changed. "
            f"To mend it: {self.remedy}."
        )


class HeldError(BladetwinError):
    """A rotor that a worker holds: it is not touched beside the worker."""

    def __init__(self, rotor: str, owner: str | None) -> None:
        self.rotor = rotor
        self.owner = owner
        super().__init__(
            f"rotor {rotor} is being updated by {owner or 'a worker'}; nothing was changed. "
            "To mend it: try again once it is current, or wait longer with --patience."
        )


class PreconditionError(BladetwinError):
    """`what` is not, or no longer, as the caller says; nothing was changed."""

    def __init__(self, what: str, remedy: str) -> None:
        self.what = what
        self.remedy = remedy
        super().__init__(
            f"{what} is not as If-Match says; nothing was changed. To mend it: {remedy}."
        )


class KeysMissingError(BladetwinError):
    """Requests need a key, and the database has no usable one."""

    def __init__(self, host: str) -> None:
        self.host = host
        super().__init__(
            f"keys are required to listen on {host or 'every address'}, and the database has no "
            "usable one: every request would be refused. To mend it: run "
            "`bladetwin keys create NAME --scope read --scope ingest --scope operate`, or serve on "
            "127.0.0.1 with BLADETWIN_KEYS=auto."
        )


class BackupError(BladetwinError):
    """A backup that is not made, or not restored; nothing was changed."""

    def __init__(self, problem: str, remedy: str) -> None:
        self.problem = problem
        self.remedy = remedy
        super().__init__(f"{problem}; nothing was changed. To mend it: {remedy}.")


class SchemaError(BladetwinError):
    """A database whose schema is not that of this release."""


class WebhooksOffError(BladetwinError):
    """Webhooks are not in use here: nothing to make their secrets of."""

    def __init__(self, setting: str) -> None:
        self.setting = setting
        self.remedy = f"set {setting} to a file with 32 or more random bytes"
        super().__init__(f"webhooks are not in use here. To mend it: {self.remedy}.")


class NotInstalledError(BladetwinError):
    """A format that this service cannot write: `package` is not installed, `extra` brings it."""

    def __init__(self, package: str, extra: str, instead: str) -> None:
        self.package = package
        self.remedy = f"install bladetwin[{extra}] on the server, or {instead}"
        super().__init__(f"{package} is not installed here. To mend it: {self.remedy}.")


class LostLeaseError(BladetwinError):
    """The fence of a worker no longer holds: nothing of its work is written."""

    def __init__(self, rotor: str, fence: int) -> None:
        self.rotor = rotor
        self.fence = fence
        super().__init__(f"rotor {rotor}: fence {fence} no longer holds; the update is dropped")


class StoreAwayError(BladetwinError):
    """The database does not answer, or is too busy; the transaction was rolled back.

    cause    the kind of error, as strangers are told it
    reason   what the driver says, for logs and commands
    """

    def __init__(self, cause: str, reason: str = "") -> None:
        self.cause = cause
        self.reason = reason or cause
        super().__init__(f"the database does not answer ({cause}); nothing was stored. Try again.")
