"""Users, of whom one stays an admin."""

import datetime as dt
import threading

import pytest
from joins import OTHER_KEY, OTHER_MAC
from robotether_server import passwords
from robotether_server.db import credentials, users
from robotether_server.db.audit import Source
from robotether_server.problems import (
    FieldInvalidError,
    LastAdminError,
    RobotetherError,
    TokenInvalidError,
)
from robotether_server.services import tokens
from robotether_server.services import users as user_service

ADMIN = Source("root")
PASSWORD = "a long enough password"


def test_first_admin_is_made_where_there_is_no_user(database):
    """Of several servers that start at once one makes it, and none where there is any user."""
    together = threading.Barrier(4)
    made = []

    def start(password):
        with database.transaction() as tx:
            # What the transaction sees is settled before any of them adds.
            assert users.list_all(tx) == []
            together.wait(10)
            if user_service.add_first(tx, ADMIN, password):
                made.append(password)

    threads = [threading.Thread(target=start, args=(f"{PASSWORD} {n}",)) for n in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30)
    with database.transaction() as tx:
        [admin] = users.list_all(tx)
        assert (admin.name, admin.role) == ("admin", "admin")
        [password] = made
        assert passwords.matches(password, admin.password_hash)
        user_service.add(tx, ADMIN, "ann", PASSWORD, "admin")
        user_service.remove(tx, ADMIN, "admin")
        assert not user_service.add_first(tx, ADMIN, PASSWORD)


@pytest.mark.parametrize("name", user_service.PARTS)
def test_no_user_has_the_name_of_who_acts_but_is_no_user(database, name):
    with (
        database.transaction() as tx,
        pytest.raises(FieldInvalidError, match="a part of the server"),
    ):
        user_service.add(tx, ADMIN, name, PASSWORD, "user")


def test_new_password_log_out_and_disabling_end_logins(site):
    """Each says so in the log, without the password."""
    with site.database.transaction() as tx:
        ann = users.get(tx, "ann")
        for _ in range(2):
            text = credentials.create_login(tx, ann, "192.0.2.1", dt.timedelta(hours=1))
        assert user_service.log_out_everywhere(tx, ADMIN, "ann") == 2
        assert credentials.find_login_user(tx, text) is None
        text = credentials.create_login(tx, ann, "192.0.2.1", dt.timedelta(hours=1))
        user_service.set_password(tx, ADMIN, "ann", PASSWORD)
        assert credentials.find_login_user(tx, text) is None
        assert passwords.matches(PASSWORD, users.get(tx, "ann").password_hash)
        text = credentials.create_login(tx, ann, "192.0.2.1", dt.timedelta(hours=1))
        for disabled in (True, False):
            user_service.set_disabled(tx, ADMIN, "ann", disabled=disabled)
        assert credentials.find_login_user(tx, text) is None
    assert PASSWORD not in repr(site.events("password_set"))
    assert len(site.events("logins_ended")) == 1


LAST = [
    lambda tx: user_service.remove(tx, ADMIN, "root"),
    lambda tx: user_service.set_disabled(tx, ADMIN, "root", disabled=True),
    lambda tx: user_service.set_role(tx, ADMIN, "root", "user"),
]


@pytest.mark.parametrize("action", LAST)
def test_last_admin_stays(site, action):
    """Another admin who is disabled does not count; one who is enabled does."""
    with site.database.transaction() as tx:
        user_service.set_role(tx, ADMIN, "ann", "admin")
        user_service.set_disabled(tx, ADMIN, "ann", disabled=True)
        with pytest.raises(LastAdminError, match="make another user an admin first"):
            action(tx)
        user_service.set_disabled(tx, ADMIN, "ann", disabled=False)
        action(tx)


def test_two_admins_who_remove_each_other_are_not_both_heard(site):
    with site.database.transaction() as tx:
        user_service.set_role(tx, ADMIN, "ann", "admin")
    together = threading.Barrier(2)
    problems = []

    def remove(name):
        try:
            with site.database.transaction() as tx:
                together.wait(20)
                user_service.remove(tx, ADMIN, name)
        except RobotetherError as problem:
            problems.append(problem)

    threads = [threading.Thread(target=remove, args=(name,)) for name in ("ann", "root")]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30)
    with site.database.transaction() as tx:
        assert len(users.list_all(tx)) == 1
    assert len(problems) == 1


@pytest.mark.parametrize("end", ["role", "disabled", "removed"])
def test_an_admin_who_is_one_no_more_takes_the_join_tokens_along(site, end):
    """Whoever wrote one down lets no more robots in with it; other admins' tokens stay."""
    later = dt.datetime.now(dt.UTC) + dt.timedelta(hours=1)
    with site.database.transaction() as tx:
        user_service.set_role(tx, ADMIN, "ann", "admin")
        texts = [
            tokens.create_join_token(tx, Source(maker), maker, 10, later)
            for maker in ("ann", "root")
        ]
        if end == "role":
            user_service.set_role(tx, ADMIN, "ann", "user")
        elif end == "disabled":
            user_service.set_disabled(tx, ADMIN, "ann", disabled=True)
        else:
            user_service.remove(tx, ADMIN, "ann")
    with pytest.raises(TokenInvalidError):
        site.ask(OTHER_MAC, OTHER_KEY, token=texts[0])
    assert site.ask(OTHER_MAC, OTHER_KEY, token=texts[1]).code == "active"
    assert len(site.events("join_token_deleted")) == 1
