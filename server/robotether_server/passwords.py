"""Hashes and checks passwords with argon2id; used by web and cli.

Two hashes at a time at most, so that a burst of logins can fill neither memory nor processor.
"""

import secrets
import threading

from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError

from robotether_server.problems import FieldInvalid

SHORTEST = 12
LONGEST = 1024
MEMORY_KIB = 32 * 1024
AT_ONCE = 2

_hasher = PasswordHasher(time_cost=3, memory_cost=MEMORY_KIB, parallelism=1)
_turn = threading.BoundedSemaphore(AT_ONCE)
# Stands in for the hash of a user who does not exist, so that the answer takes as long.
_NOBODY = _hasher.hash(secrets.token_hex())


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
