"""Users: listed, added, shown, and what an admin changes after a question."""

import re

from admin_visitor import send
from robotether_server.db import users
from web_visitor import Browser


def test_a_password_that_was_made_is_shown_once_and_works(app, admin):
    answer = send(admin, "/admin/users", name="zoe", role="user", password="")
    assert answer.status_code == 200
    shown = re.search(r'data-testid="secret">([^<]+)<', answer.text)
    assert shown[1] not in str(answer.headers)
    assert answer.headers["Cache-Control"] == "no-store"
    assert shown[1] not in admin.ask("GET", "/admin/users/zoe").text
    zoe = Browser(app.test_client())
    assert zoe.log_in("zoe", shown[1]).status_code == 303
    # The old one holds no more, nor do logins made with it.
    answer = send(admin, "/admin/users/zoe/password", password="")
    new = re.search(r'data-testid="secret">([^<]+)<', answer.text)
    assert zoe.ask("GET", "/").status_code == 302
    assert zoe.log_in("zoe", shown[1]).status_code == 401
    assert zoe.log_in("zoe", new[1]).status_code == 303


def test_a_password_that_was_typed_is_not_shown(admin, database):
    form = {"name": "zoe", "role": "admin"}
    answer = send(admin, "/admin/users", **form, password="short")
    assert (answer.status_code, "Use at least 12 characters" in answer.text) == (422, True)
    assert "short" not in answer.text
    answer = send(admin, "/admin/users", **form, password="typed by an admin")
    assert (answer.status_code, answer.location) == (303, "/admin/users/zoe")
    with database.transaction() as tx:
        assert users.get(tx, "zoe").role == "admin"


def test_a_question_about_a_user_does_nothing_to_who_got_the_name_since(admin, database):
    page = "/admin/users/ann/remove"
    [meant] = re.findall(r'name="meant" value="([^"]+)"', admin.ask("GET", page).text)
    send(admin, page, meant=meant)
    send(admin, "/admin/users", name="ann", role="user", password="another person's")
    answer = send(admin, page, meant=meant)
    assert (answer.status_code, "what has this name now is another one" in answer.text) == (
        404,
        True,
    )
    with database.transaction() as tx:
        assert users.get(tx, "ann")


def test_ticked_users_are_enabled_again_and_the_last_admin_stays(admin):
    send(admin, "/admin/selected-users/disable", users="ann olga")
    assert send(admin, "/admin/selected-users/enable", users="ann olga").status_code == 303
    assert admin.ask("GET", "/admin/users?user=ann").text.count(">Enabled<") == 3
    own = admin.ask("GET", "/admin/selected-users/disable?user=root&user=ann").text
    assert ("You are one of them." in own, "Join tokens of root" in own) == (True, True)
    assert send(admin, "/admin/selected-users/disable", users="ann root").status_code == 409
    assert admin.ask("GET", "/admin/users").text.count(">Enabled<") == 3
