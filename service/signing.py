"""Secrets and signatures of webhooks.

Signatures are those of Standard Webhooks (symmetric, v1), for which receivers have libraries:

    webhook-id         of the message; the same each time that it is sent
    webhook-timestamp  of the sending, seconds since 1970
    webhook-signature  "v1," + base64(HMAC-SHA256(secret, id + "." + timestamp + "." + body))

A secret has to be at hand to sign, so no digest of it would do. It is not kept either: it is made
from the bytes of a key file, which the database does not hold, by HMAC-SHA256 over the webhook's
id and a random salt. Who reads the database, or a backup of it, learns salts and fingerprints, from
which no secret can be made. The fingerprint tells when the key file is not the one it was.
"""

from __future__ import annotations

import base64
import binascii
import hmac
import time
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path

from core.errors import BladetwinError, InputError

PREFIX = "whsec_"
LEAST_BYTES = 32
TOLERANCE_S = 300.0
SETTING = "BLADETWIN_WEBHOOK_KEY_FILE"


class SignatureError(BladetwinError):
    """A message that was not signed with the secret, or not lately."""


def read_key(path: str) -> bytes:
    """The bytes of the key file; InputError: it cannot be read or is too short to be secret."""
    try:
        key = Path(path).read_bytes().strip()
    except OSError as error:
        problem = f"cannot be read: {error.strerror or error}"
        raise InputError(SETTING, path, problem, "let the service's user read it") from None
    if len(key) < LEAST_BYTES:
        remedy = f"write {LEAST_BYTES} or more random bytes, e.g. `openssl rand -hex 32`"
        raise InputError(SETTING, path, f"holds {len(key)} bytes", remedy)
    return key


def secret_of(key: bytes, webhook_id: str, salt: str) -> str:
    """The secret of a webhook, as its receiver gets it: ``whsec_`` and base64 of 32 bytes."""
    made = hmac.digest(key, f"bladetwin webhook\0{webhook_id}\0{salt}".encode(), "sha256")
    return PREFIX + base64.b64encode(made).decode()


def fingerprint(secret: str) -> str:
    """SHA-256 of a secret, hexadecimal."""
    return sha256(secret.encode()).hexdigest()


def sign(secret: str, message_id: str, at: int, body: bytes) -> str:
    """The signature of a message, with its version before it.

    >>> sign("whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw", "msg_p5jXN8AQM9LWM0D4loKWxJek",
    ...      1614265330, b'{"test": 2432232314}')
    'v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE='
    """
    content = b".".join([message_id.encode(), str(at).encode(), body])
    made = hmac.digest(base64.b64decode(secret.removeprefix(PREFIX)), content, "sha256")
    return "v1," + base64.b64encode(made).decode()


def headers_of(secret: str, message_id: str, at: int, body: bytes) -> dict[str, str]:
    """The three headers of a message."""
    return {
        "webhook-id": message_id,
        "webhook-timestamp": str(at),
        "webhook-signature": sign(secret, message_id, at, body),
    }


def verified(
    secret: str,
    headers: Mapping[str, str],
    body: bytes,
    *,
    tolerance_s: float = TOLERANCE_S,
    now: float | None = None,
) -> str:
    """The message's id, where it was signed with the secret within the last `tolerance_s`.

    headers   names in any case; `webhook-signature` may list several, of which one has to fit
    body      as it came, byte for byte

    Raises SignatureError.
    """
    told = {name.lower(): value for name, value in headers.items()}
    try:
        message_id = told["webhook-id"]
        at, signatures = told["webhook-timestamp"], told["webhook-signature"]
    except KeyError as error:
        raise SignatureError(f"the header {error} is missing") from None
    if not (at.isascii() and at.isdigit() and len(at) < 15):
        raise SignatureError(f"webhook-timestamp {at[:40]!r} is no time in seconds")
    age = (time.time() if now is None else now) - int(at)
    if abs(age) > tolerance_s:
        raise SignatureError(
            f"signed {age:.0f} s ago, more than {tolerance_s:g} s: a copy, or a clock is wrong"
        )
    try:
        own = sign(secret, message_id, int(at), body)
    except (binascii.Error, ValueError):
        raise SignatureError("the secret is no base64 after whsec_") from None
    if not any(hmac.compare_digest(own.encode(), one.encode()) for one in signatures.split(" ")):
        raise SignatureError("no signature fits: another secret, or the body was changed")
    return message_id
