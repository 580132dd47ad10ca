"""The seal on a permit: whoever wrote it holds the session's key.

The launcher makes a key for each session and hands it to the interlock and the arm alone, on their standard input. So
nobody else who reaches the bus, and no log that is played back onto it, can grant motion. A seal is no secret and is
recorded; the key is written nowhere.
"""

from __future__ import annotations

import hmac
import secrets
from dataclasses import replace

from runtime.bus import encode
from runtime.messages import Permit

KEY_LENGTH = 32  # bytes
_SEAL_LENGTH = 16  # bytes of the HMAC-SHA256


def new_key() -> bytes:
    """A key for one session: (32,) random bytes."""
    return secrets.token_bytes(KEY_LENGTH)


def sealed(permit: Permit, key: bytes) -> Permit:
    """The permit with its seal; without one where there is no key."""
    return replace(permit, seal=_seal(permit, key) if key else "")


def is_genuine(permit: Permit, key: bytes) -> bool:
    """Whether the seal is that of somebody who holds the key, and nothing was changed since."""
    return hmac.compare_digest(_seal(permit, key).encode(), permit.seal.encode(errors="replace"))


def _seal(permit: Permit, key: bytes) -> str:
    """HMAC-SHA256, shortened, of the CDR of everything else, in hexadecimal."""
    return hmac.digest(key, encode(replace(permit, seal="")), "sha256")[:_SEAL_LENGTH].hex()
