"""Checks a name and a password, and starts or ends the login.

Used by the log-in page and the profile. An unknown name, a disabled user and a wrong password look the same, and
take as long. A guess counts as a failure from before its check until its outcome is in the log, or guesses sent at
once would all pass the throttle before the first of them is recorded; and only once, also in the moment in which
it is both open and in the log. Three limits, each against one attacker:

* one network that tries many passwords of one user; a success clears the failures of that pair;
* one network that tries many users;
* many networks that try one user. This one does not count where that user has logged in before, so that
  nobody can lock a user out of the usual places by failing on purpose.
"""

import datetime as dt
import math
import threading
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import takewhile

from robotether_server import passwords
from robotether_server.db import Database, Transaction, audit, credentials, users
from robotether_server.db.audit import Network, Occurrence, Source, network_of
from robotether_server.db.users import User
from robotether_server.problems import LoginFailedError, ThrottledError

FAILED = "login_failed"
SUCCEEDED = "login"
WINDOW = dt.timedelta(minutes=10)
PER_USER_AND_NETWORK = 5
PER_NETWORK = 30
PER_USER = 50


@dataclass(eq=False)
class Guess:
    """A password that is being checked; `outcome` is its event's id from before others can read that in the log."""

    user: str
    network: Network
    at: dt.datetime
    checked: User | None = None
    outcome: int | None = None


@dataclass(frozen=True)
class Failures:
    """Times within WINDOW, the oldest first.

    `of_pair`: of this user from this network since they last fitted; `of_network`: of any user from it;
    `of_user`: of this user from anywhere, empty where the user has logged in before.
    """

    of_pair: Sequence[dt.datetime] = ()
    of_network: Sequence[dt.datetime] = ()
    of_user: Sequence[dt.datetime] = ()


class OpenGuesses:
    """The guesses whose outcome is not in the log yet. web is one process, so its memory knows them all."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._open: list[Guess] = []

    @contextmanager
    def with_one_more(self, guess: Guess) -> Iterator[list[Guess]]:
        """Count the guess inside the block, for those that come after it; give those that came before."""
        with self._lock:
            before = list(self._open)
            self._open.append(guess)
        try:
            yield before
        finally:
            with self._lock:
                self._open.remove(guess)


_open_guesses = OpenGuesses()


def log_in(database: Database, source: Source, password: str, lifetime: dt.timedelta) -> str:
    """Return the text for the cookie; raise LoginFailedError or Throttled. `source` has the claimed name."""
    with _guessed(database, source, password) as guess, database.transaction() as tx:
        # The check takes long: an admin who has set another password meanwhile has ended all logins with this one.
        if guess.checked is not None and users.is_unchanged(tx, guess.checked):
            guess.outcome = audit.record(tx, source, SUCCEEDED)
            return credentials.create_login(tx, guess.checked, source.address or "", lifetime)
        guess.outcome = audit.record(tx, source, FAILED)
    raise LoginFailedError("Wrong name or password.")


def confirm(database: Database, source: Source, password: str) -> None:
    """Check the password of somebody who is logged in; raise LoginFailedError or Throttled.

    A browser that was left open must not be a way to guess it, so a failure counts as one of a login does.
    """
    with _guessed(database, source, password) as guess:
        if guess.checked is not None:
            return
        with database.transaction() as tx:
            guess.outcome = audit.record(tx, source, FAILED)
    raise LoginFailedError("cannot continue: the current password is wrong")


@contextmanager
def _guessed(database: Database, source: Source, password: str) -> Iterator[Guess]:
    """Give the guess, `checked` if it is right; raise Throttled. The block writes the outcome to the log.

    No transaction stays open while the password is hashed, which takes long on purpose.
    """
    with ExitStack() as stack:
        with database.transaction() as tx:
            # As the log has it: by the clock of a machine that is ahead no failure would count.
            guess = Guess(source.actor, network_of(source.address or ""), tx.now())
            before = stack.enter_context(_open_guesses.with_one_more(guess))
            _check_throttle(tx, guess, before)
            user = users.find(tx, guess.user)
        right = passwords.matches(password, user.password_hash if user else None)
        if user is not None and right and not user.disabled:
            guess.checked = user
        yield guess


def log_out(database: Database, source: Source, text: str) -> None:
    """End one login."""
    with database.transaction() as tx:
        if credentials.end_login(tx, text):
            audit.record(tx, source, "logout")


def _check_throttle(tx: Transaction, guess: Guess, before: list[Guess]) -> None:
    allowed_at = free_at(_failures(tx, guess, before))
    if allowed_at is None or allowed_at <= guess.at:
        return
    wait_s = math.ceil((allowed_at - guess.at).total_seconds())
    raise ThrottledError(
        f"cannot log in now: too many attempts failed; try again at {allowed_at:%H:%M:%S} UTC "
        f"(in {math.ceil(wait_s / 60)} min)",
        wait_s,
    )


def _failures(tx: Transaction, guess: Guess, before: list[Guess]) -> Failures:
    """Return the failures of the log, and as the newest of them the guesses that are open."""
    user, network, since = guess.user, guess.network, guess.at - WINDOW
    tries = audit.recent_from(tx, (FAILED, SUCCEEDED), network, since)
    tries += _still_open([other for other in before if other.network == network], tries)
    own = [event for event in tries if event.actor == user]
    since_success = takewhile(lambda event: event.kind == FAILED, reversed(own))
    of_user: list[Occurrence] = []
    if not audit.has_come_from(tx, SUCCEEDED, user, network):
        of_user = audit.recent_of(tx, FAILED, user, since)
        of_user += _still_open([other for other in before if other.user == user], of_user)
    return Failures(
        of_pair=[event.at for event in since_success][::-1],
        of_network=[event.at for event in tries if event.kind == FAILED],
        of_user=[event.at for event in of_user],
    )


def _still_open(guesses: list[Guess], logged: list[Occurrence]) -> list[Occurrence]:
    """Return as failures the guesses whose outcome is not among what has just been read of the log."""
    ids = {event.id for event in logged}
    return [
        Occurrence(FAILED, guess.user, guess.at) for guess in guesses if guess.outcome not in ids
    ]


def free_at(failures: Failures) -> dt.datetime | None:
    """Return the time from which an attempt is accepted, or None when it is accepted now."""
    ends = (
        _free_at_limit(failures.of_pair, PER_USER_AND_NETWORK),
        _free_at_limit(failures.of_network, PER_NETWORK),
        _free_at_limit(failures.of_user, PER_USER),
    )
    return max((end for end in ends if end is not None), default=None)


def _free_at_limit(timestamps: Sequence[dt.datetime], limit: int) -> dt.datetime | None:
    # Fewer than `limit` are left in the window once the one at this place has gone out of it.
    return timestamps[-limit] + WINDOW if len(timestamps) >= limit else None
