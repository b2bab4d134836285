"""Checks a name and a password, and starts or ends the login.

Used by pages.py. An unknown name, a disabled user and a wrong password look the same, and take as long.
"""

import datetime as dt
import math

from robotether_server import passwords
from robotether_server.problems import LoginFailed, Throttled
from robotether_server.store import Database, Transaction, audit, logins, users
from robotether_server.store.audit import Event, Source
from robotether_server.web import throttle

FAILED = "login_failed"


def log_in(database: Database, source: Source, password: str, lifetime: dt.timedelta) -> str:
    """Return the text for the cookie; raise LoginFailed or Throttled. `source` has the claimed name.

    No transaction stays open while the password is hashed, which takes long on purpose.
    """
    with database.transaction() as tx:
        _check_throttle(tx, source)
        user = users.find(tx, source.actor)
    right = passwords.matches(password, user.password_hash if user else None)
    with database.transaction() as tx:
        if user is None or user.disabled or not right:
            audit.record(tx, source, Event(FAILED))
        else:
            audit.record(tx, source, Event("login"))
            return logins.create(tx, user, source.address or "", lifetime)
    raise LoginFailed("cannot log in: name and password do not fit")


def log_out(database: Database, source: Source, text: str) -> None:
    """End one login."""
    with database.transaction() as tx:
        if logins.end(tx, text):
            audit.record(tx, source, Event("logout"))


def _check_throttle(tx: Transaction, source: Source) -> None:
    now = dt.datetime.now(dt.UTC)
    failures = audit.recent_moments(tx, FAILED, source.address or "", now - throttle.WINDOW)
    free_at = throttle.free_at(failures, source.actor)
    if free_at is None or free_at <= now:
        return
    wait_s = math.ceil((free_at - now).total_seconds())
    raise Throttled(
        f"cannot log in now: too many tries failed; try again at {free_at:%H:%M:%S} UTC "
        f"(in {math.ceil(wait_s / 60)} min)",
        wait_s,
    )
