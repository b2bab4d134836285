"""Hashes and checks passwords with argon2id; used by web and cli.

Two hashes at a time at most, so that a burst of logins can fill neither memory nor processor.
"""

import base64
import secrets
import threading

from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError

from robotether_server.problems import FieldInvalid

SHORTEST = 12
LONGEST = 1024
MEMORY_KIB = 32 * 1024
TIME_COST = 3
SALT_BYTES, HASH_BYTES = 16, 32
AT_ONCE = 2

_hasher = PasswordHasher(
    time_cost=TIME_COST,
    memory_cost=MEMORY_KIB,
    parallelism=1,
    salt_len=SALT_BYTES,
    hash_len=HASH_BYTES,
)
_turn = threading.BoundedSemaphore(AT_ONCE)


def _random_text(count: int) -> str:
    return base64.b64encode(secrets.token_bytes(count)).decode().rstrip("=")


# Stands in for the hash of a user who does not exist, so that the answer takes as long. No password has it; to hash
# one for it would cost each start of the command a tenth of a second.
_NOBODY = (
    f"$argon2id$v=19$m={MEMORY_KIB},t={TIME_COST},p=1"
    f"${_random_text(SALT_BYTES)}${_random_text(HASH_BYTES)}"
)


def new_password() -> str:
    """Return a password that nobody can guess and a person can copy."""
    return secrets.token_urlsafe(18)


def hash_password(password: str) -> str:
    """Return the text for users.password_hash; raise FieldInvalid when it is too short or long."""
    if not SHORTEST <= len(password) <= LONGEST:
        raise FieldInvalid(
            f"cannot use this password: it has {len(password)} characters; "
            f"allowed are {SHORTEST} to {LONGEST}"
        )
    with _turn:
        return _hasher.hash(password)


def matches(password: str, password_hash: str | None) -> bool:
    """Tell whether the password is right; None: there is no such user, which takes as long."""
    try:
        with _turn:
            _hasher.verify(password_hash or _NOBODY, password[:LONGEST])
    except (VerificationError, InvalidHashError):
        return False
    return password_hash is not None
