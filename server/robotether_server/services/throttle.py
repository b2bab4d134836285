"""Decides when the next log-in attempt is allowed: pure rules over the failures of the last minutes.

Used by logging_in.py, which reads the failures from the audit log. Three limits, each against one attacker:

* one network that tries many passwords of one user; a success clears the failures of that pair;
* one network that tries many users;
* many networks that try one user. This one does not count where that user has logged in before, so that
  nobody can lock a user out of the usual places by failing on purpose.
"""

import datetime as dt
from collections.abc import Sequence
from dataclasses import dataclass

WINDOW = dt.timedelta(minutes=10)
PER_USER_AND_NETWORK = 5
PER_NETWORK = 30
PER_USER = 50


@dataclass(frozen=True)
class Failures:
    """Moments within WINDOW, the oldest first.

    `of_pair`: of this user from this network since they last fitted; `of_network`: of any user from it;
    `of_user`: of this user from anywhere, empty where the user has logged in before.
    """

    of_pair: Sequence[dt.datetime] = ()
    of_network: Sequence[dt.datetime] = ()
    of_user: Sequence[dt.datetime] = ()


def free_at(failures: Failures) -> dt.datetime | None:
    """Return the time from which an attempt is accepted, or None when it is accepted now."""
    ends = (
        _free_at(failures.of_pair, PER_USER_AND_NETWORK),
        _free_at(failures.of_network, PER_NETWORK),
        _free_at(failures.of_user, PER_USER),
    )
    return max((end for end in ends if end is not None), default=None)


def _free_at(timestamps: Sequence[dt.datetime], limit: int) -> dt.datetime | None:
    # Fewer than `limit` are left in the window once the one at this place has gone out of it.
    return timestamps[-limit] + WINDOW if len(timestamps) >= limit else None
