"""Hashes and checks passwords with argon2id; used by web and cli.

Two hashes at a time at most, so that a burst of logins can fill neither memory nor processor; and two more wait, so
that it cannot take all threads of web.
"""

import base64
import re
import secrets
import string
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError

from robotether_server.problems import FieldInvalidError, ThrottledError

MIN_LENGTH = 12
MAX_LENGTH = 1024
MEMORY_KIB = 32 * 1024
TIME_COST = 3
SALT_BYTES, HASH_BYTES = 16, 32
AT_ONCE = 2
# Maximum number of passwords that wait for those: each holds a thread of web, which has eight.
MAX_WAITING = 2
THROTTLED_S = 2

# What common passwords of this length are made of. Lists of real ones hold few that are as long.
_COMMON = """
a abc access admin administrator amazon and android ansible apple april asdf asdfghjkl august
autumn azerty bar baseball batman change changeme charlie chocolate cloud company computer cookie
debian december default demo docker dragon ever facebook february flower foo football freedom
friday friend github google guest hello hunter i ich iloveyou internet is it january jesus jordan
july june letme letmein linkedin linux login love lovely march mariadb master may me michael
microsoft monday monkey mustang my mysql never new ninja no not november october office one online
operator pass passw passwd password passwort pi please pokemon princess public qwert qwerty
qwertyuiop qwertz raspberry raspbian remote robot robotether robotics robots root ros rosbridge
samsung saturday secret secure security september server service shadow spring start starwars
summer sunday sunshine super superman supervisor support sysadmin system teleop temp temporary
test tester testing the this thursday trustno tuesday turtle turtlebot turtlesim two ubuntu user
users vm wednesday welcome whatever winter word world x yes you your zaq zaqwsx
"""
COMMON_WORDS = tuple(_COMMON.split())
LOOKALIKES = str.maketrans("013457@$!", "oleastasi")
_LETTERS = string.ascii_lowercase
_KEYS = ("1234567890", "qwertyuiop", "asdfghjkl", "zxcvbnm")
_COLUMNS = (
    "1qaz2wsx3edc4rfv5tgb6yhn7ujm",
    "qazwsxedcrfvtgbyhnujm",
    "1q2w3e4r5t6y7u8i9o0p",
    "q1w2e3r4t5y6u7i8o9p0",
)
ROWS = tuple(
    row[::way]
    for row in (_LETTERS * 2, "".join(_KEYS), "".join(_KEYS[1:]), *_COLUMNS)
    for way in (1, -1)
)
# Maximum number of different characters, in one case, of a weak password.
FEW_CHARACTERS = 4
_NO_LETTER = re.compile("[^a-z]")

_hasher = PasswordHasher(
    time_cost=TIME_COST,
    memory_cost=MEMORY_KIB,
    parallelism=1,
    salt_len=SALT_BYTES,
    hash_len=HASH_BYTES,
)
_turn = threading.BoundedSemaphore(AT_ONCE)
_places = threading.BoundedSemaphore(AT_ONCE + MAX_WAITING)


@contextmanager
def _in_turn() -> Iterator[None]:
    if not _places.acquire(blocking=False):
        raise ThrottledError(
            "cannot check the password now: too many people log in at this moment; try again in a few seconds",
            THROTTLED_S,
        )
    try:
        with _turn:
            yield
    finally:
        _places.release()


def _random_text(count: int) -> str:
    return base64.b64encode(secrets.token_bytes(count)).decode().rstrip("=")


# Replaces the hash of a user who does not exist, so that the answer takes as long. No password has it; to hash
# one for it would cost each start of the command a tenth of a second.
_NOBODY = (
    f"$argon2id$v=19$m={MEMORY_KIB},t={TIME_COST},p=1"
    f"${_random_text(SALT_BYTES)}${_random_text(HASH_BYTES)}"
)


def new_password() -> str:
    """Return a password that nobody can guess and a person can copy."""
    return secrets.token_urlsafe(18)


def hash_password(password: str) -> str:
    """Return the text for users.password_hash; raise FieldInvalidError or ThrottledError."""
    if not MIN_LENGTH <= len(password) <= MAX_LENGTH:
        raise FieldInvalidError(
            f"cannot use this password: use at least {MIN_LENGTH} characters"
            if len(password) < MIN_LENGTH
            else f"cannot use this password: use at most {MAX_LENGTH} characters",
            "password",
        )
    if is_common(password):
        raise FieldInvalidError(
            "cannot use this password: it is among those that are tried first; choose another, such as "
            "four words that have nothing to do with each other",
            "password",
        )
    with _in_turn():
        return _hasher.hash(password)


def is_common(password: str) -> bool:
    """Return whether it is built like common passwords: few characters, a row of keys, or common words and digits."""
    text = password.lower()
    if text.isdigit() or len(set(text)) <= FEW_CHARACTERS or any(text in row for row in ROWS):
        return True
    # P@ssw0rd2024! is read as password, and so is password-2024-password.
    spelt = text.strip(string.digits + string.punctuation + " ").translate(LOOKALIKES)
    return any(_is_of_words(_NO_LETTER.sub("", variant)) for variant in (text, spelt))


def _is_of_words(letters: str) -> bool:
    """Return whether the text is common words and nothing else. A regular expression could need exponential time."""
    reached = {0}
    for place in range(len(letters)):
        if place in reached:
            reached |= {
                place + len(word) for word in COMMON_WORDS if letters.startswith(word, place)
            }
    return bool(letters) and len(letters) in reached


def matches(password: str, password_hash: str | None) -> bool:
    """Return whether the password is right; None for an unknown user, which takes as long. Raises ThrottledError."""
    try:
        with _in_turn():
            _hasher.verify(password_hash or _NOBODY, password[:MAX_LENGTH])
    except (VerificationError, InvalidHashError):
        return False
    return password_hash is not None
