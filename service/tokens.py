"""API keys as text: made, taken apart, compared.

A token is ``btk_<id>_<secret>``: an id of 48 bits that is no secret (logs and lists name it), and
a secret of 256 bits from the system's random source. The database keeps the SHA-256 of the whole
token. A slow hash (argon2, scrypt) protects what people choose, which can be guessed; among 2^256
equally likely secrets there is nothing to guess, so one SHA-256 is as good, and a request costs
microseconds instead of a tenth of a second that anybody could make the service spend. Digests are
compared in constant time.

The prefix lets scanners of source code find a key that got lost, and `redacted` takes it out of
every log line and audit row.
"""

from __future__ import annotations

import re
import secrets
from hashlib import sha256
from hmac import compare_digest

_SHAPE = r"btk_([0-9a-f]{12})_[A-Za-z0-9_-]{43}"
TOKEN = re.compile(_SHAPE)
HIDDEN = re.compile(r"btk_([0-9a-f]{12})_[A-Za-z0-9_-]+")


def new_token() -> tuple[str, str]:
    """A new key's id and token."""
    key_id = secrets.token_hex(6)
    return key_id, f"btk_{key_id}_{secrets.token_urlsafe(32)}"


def digest(token: str) -> str:
    """What the database keeps of a token.

    >>> len(digest("btk_0123456789ab_" + 43 * "A"))
    64
    """
    return sha256(token.encode()).hexdigest()


def id_of(token: str) -> str | None:
    """The id that a token names; None: it has not the shape of one.

    >>> id_of("btk_0123456789ab_" + 43 * "A"), id_of("btk_0123456789ab_short")
    ('0123456789ab', None)
    """
    found = TOKEN.fullmatch(token)
    return None if found is None else found[1]


def matches(token: str, kept: str | None) -> bool:
    """Whether the kept digest is the token's, in the same time whatever it is, or is None."""
    same = compare_digest(digest(token), kept or 64 * "0")
    return same and kept is not None


def redacted(text: str) -> str:
    """A text without the secrets of tokens in it.

    >>> redacted("GET /v1/models?key=btk_0123456789ab_" + 43 * "A")
    'GET /v1/models?key=btk_0123456789ab_…'
    """
    return HIDDEN.sub(r"btk_\1_…", text)
