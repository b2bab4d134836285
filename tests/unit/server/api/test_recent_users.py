"""The users whom web remembers for a while, for when the database is away."""

from robotether_server.api import recent_users
from robotether_server.api.recent_users import RecentUser, RecentUsers

FIRST, SECOND, THIRD = (("login", text) for text in ("01", "02", "03"))
ANN = RecentUser(1, "ann")


def test_a_user_is_found_by_the_credential_for_a_while(monkeypatch):
    """They are bounded: what was confirmed longest ago goes first."""
    now = 0.0
    monkeypatch.setattr(recent_users, "MAX_RECENT", 2)
    users = RecentUsers(lambda: now)
    for credential in (FIRST, SECOND, FIRST, THIRD):
        users.note(credential, ANN)
    now = recent_users.RECENT_S - 1
    assert [users.find(item) for item in (FIRST, SECOND, THIRD)] == [ANN, None, ANN]
    assert users.find(("token", "01")) is None
    users.note(THIRD, ANN)
    now = recent_users.RECENT_S
    assert [users.find(item) for item in (FIRST, THIRD)] == [None, ANN]
