"""Checks a name and a password, and starts or ends the login.

Used by pages.py and the profile. An unknown name, a disabled user and a wrong password look the same, and take as long.
"""

import datetime as dt
import math
from itertools import takewhile

from robotether_server import passwords
from robotether_server.networks import Network, network_of
from robotether_server.problems import LoginFailed, Throttled
from robotether_server.store import Database, Transaction, audit, logins, users
from robotether_server.store.audit import Event, Source
from robotether_server.store.users import User
from robotether_server.web import throttle
from robotether_server.web.throttle import Failures

FAILED = "login_failed"
SUCCEEDED = "login"


def log_in(database: Database, source: Source, password: str, lifetime: dt.timedelta) -> str:
    """Return the text for the cookie; raise LoginFailed or Throttled. `source` has the claimed name."""
    user = _user_with(database, source, password)
    with database.transaction() as tx:
        if user is None:
            audit.record(tx, source, Event(FAILED))
        else:
            audit.record(tx, source, Event(SUCCEEDED))
            return logins.create(tx, user, source.address or "", lifetime)
    raise LoginFailed("cannot log in: name and password do not fit")


def confirm(database: Database, source: Source, password: str) -> None:
    """Check the password of somebody who is logged in; raise LoginFailed or Throttled.

    A browser that was left open must not be a way to guess it, so a failure counts as one of a login does.
    """
    if _user_with(database, source, password) is None:
        with database.transaction() as tx:
            audit.record(tx, source, Event(FAILED))
        raise LoginFailed("cannot go on: the present password is not right")


def _user_with(database: Database, source: Source, password: str) -> User | None:
    """Return the user of that name if the password is right; raise Throttled.

    No transaction stays open while the password is hashed, which takes long on purpose.
    """
    with database.transaction() as tx:
        _check_throttle(tx, source)
        user = users.find(tx, source.actor)
    right = passwords.matches(password, user.password_hash if user else None)
    return user if user is not None and right and not user.disabled else None


def log_out(database: Database, source: Source, text: str) -> None:
    """End one login."""
    with database.transaction() as tx:
        if logins.end(tx, text):
            audit.record(tx, source, Event("logout"))


def _check_throttle(tx: Transaction, source: Source) -> None:
    now, network = dt.datetime.now(dt.UTC), network_of(source.address or "")
    free_at = throttle.free_at(_failures(tx, source.actor, network, now - throttle.WINDOW))
    if free_at is None or free_at <= now:
        return
    wait_s = math.ceil((free_at - now).total_seconds())
    raise Throttled(
        f"cannot log in now: too many tries failed; try again at {free_at:%H:%M:%S} UTC "
        f"(in {math.ceil(wait_s / 60)} min)",
        wait_s,
    )


def _failures(tx: Transaction, user: str, network: Network, since: dt.datetime) -> Failures:
    tries = audit.recent_from(tx, (FAILED, SUCCEEDED), network, since)
    own = [one for one in tries if one.actor == user]
    since_success = takewhile(lambda one: one.kind == FAILED, reversed(own))
    is_known = audit.has_come_from(tx, SUCCEEDED, user, network)
    return Failures(
        of_pair=[one.at for one in since_success][::-1],
        of_network=[one.at for one in tries if one.kind == FAILED],
        of_user=[] if is_known else audit.recent_of(tx, FAILED, user, since),
    )
