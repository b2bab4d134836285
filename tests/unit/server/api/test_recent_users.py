"""The users whom web remembers for a while, for when the database is away."""

from robotether_server.api import recent_users
from robotether_server.api.recent_users import RecentUser, RecentUsers

LOGIN = ("login", "0f")
TOKEN = ("token", "0f")
ANN = RecentUser(1, "ann")


def test_a_user_is_found_by_the_credential_until_its_time_is_over():
    now = 0.0
    users = RecentUsers(lambda: now)
    users.note(LOGIN, ANN)
    now = recent_users.RECENT_S - 1
    assert users.find(LOGIN) == ANN
    assert users.find(TOKEN) is None
    now = recent_users.RECENT_S
    assert users.find(LOGIN) is None
    users.note(LOGIN, ANN)
    assert users.find(LOGIN) == ANN


def test_users_are_bounded(monkeypatch):
    """What was confirmed longest ago goes first."""
    monkeypatch.setattr(recent_users, "MAX_RECENT", 2)
    users = RecentUsers(lambda: 0.0)
    first, second, third = (("login", text) for text in ("01", "02", "03"))
    for credential in (first, second, first, third):
        users.note(credential, ANN)
    assert [users.find(item) for item in (first, second, third)] == [ANN, None, ANN]
