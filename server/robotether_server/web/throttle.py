"""When the next try to log in is heard: counts failures of the last minutes, in the audit log.

Used by logging_in.py. One address that tries many users and one that tries many passwords of one
user are both slowed down; somebody else's failures never lock a user out of another address.
"""

import datetime as dt
from collections.abc import Sequence

WINDOW = dt.timedelta(minutes=10)
PER_USER_AND_ADDRESS = 5
PER_ADDRESS = 30


def free_at(failures: Sequence[tuple[str, dt.datetime]], user: str) -> dt.datetime | None:
    """Return the moment from which a try is heard, or None when it is heard now.

    `failures`: user and moment of those from one address within WINDOW, the oldest first.
    """
    all_moments = [moment for _, moment in failures]
    own_moments = [moment for name, moment in failures if name == user]
    ends = (_free_at(all_moments, PER_ADDRESS), _free_at(own_moments, PER_USER_AND_ADDRESS))
    return max((end for end in ends if end is not None), default=None)


def _free_at(moments: Sequence[dt.datetime], limit: int) -> dt.datetime | None:
    # Fewer than `limit` are left in the window once the one at this place has gone out of it.
    return moments[-limit] + WINDOW if len(moments) >= limit else None
