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
