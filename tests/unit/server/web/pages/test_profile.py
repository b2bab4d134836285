"""The profile page."""

import re

import pytest
from admin_visitor import fingerprint, public_key, send
from robotether_server import passwords
from robotether_server.db import users
from web_visitor import PASSWORD, Browser

NEW = "an even longer password"


def path_of(page, kind):
    """The page that asks whether to delete the key or token."""
    return re.findall(f'href="(/profile/{kind}/[^"]+)"', page)[0]


def test_password_is_changed_and_this_browser_stays(app, ann):
    other = Browser(app.test_client())
    other.log_in("ann")
    answer = send(ann, "/profile/password", present=PASSWORD, new=NEW, again=NEW)
    assert (answer.status_code, answer.location) == (303, "/profile")
    assert ann.ask("GET", "/profile").status_code == 200
    assert other.ask("GET", "/profile").status_code == 302
    assert other.log_in("ann", PASSWORD).status_code == 401
    assert other.log_in("ann", NEW).status_code == 303


@pytest.mark.parametrize(
    ("form", "status", "sentence"),
    [
        ({"present": "wrong", "new": NEW, "again": NEW}, 401, "The current password is wrong."),
        ({"present": PASSWORD, "new": NEW, "again": "other"}, 422, "The two new ones differ."),
    ],
)
def test_what_is_wrong_is_said_and_changes_nothing(ann, form, status, sentence):
    answer = send(ann, "/profile/password", **form)
    assert (answer.status_code, sentence in answer.text) == (status, True)
    assert PASSWORD not in answer.text
    assert NEW not in answer.text
    assert ann.log_in("ann").status_code == 303


def test_an_admins_password_is_not_replaced_by_whoever_has_the_old_one(database, ann, monkeypatch):
    """It was set while the old one was checked."""

    def matches(_password, _hash):
        with database.transaction() as tx:
            users.set_password(tx, users.get(tx, "ann").id, "the admin's")
        return True

    monkeypatch.setattr(passwords, "matches", matches)
    answer = send(ann, "/profile/password", present=PASSWORD, new=NEW, again=NEW)
    assert (answer.status_code, "an admin has changed it meanwhile" in answer.text) == (401, True)
    with database.transaction() as tx:
        assert users.get(tx, "ann").password_hash == "the admin's"


def test_log_out_everywhere_ends_this_login_too(ann):
    assert "this one too" in ann.ask("GET", "/profile/log-out").text
    assert send(ann, "/profile/log-out").location == "/login"
    assert "You are logged out everywhere." in ann.ask("GET", "/login").text


def test_a_key_is_added_and_deleted(ann):
    answer = send(ann, "/profile/ssh-keys", name="laptop", public_key=public_key(1))
    assert (answer.status_code, answer.location) == (303, "/profile#ssh-keys")
    page = ann.ask("GET", "/profile").text
    assert fingerprint(1) in page.replace("</span><span>", "")
    path = path_of(page, "ssh-keys")
    assert "Delete SSH key laptop?" in ann.ask("GET", path).text
    assert send(ann, path).status_code == 303
    assert "You have none here yet" in ann.ask("GET", "/profile").text


def test_another_users_key_and_token_are_out_of_reach(ann, admin):
    send(ann, "/profile/ssh-keys", name="laptop", public_key=public_key(1))
    send(ann, "/profile/tokens", name="notebook", days="30")
    page = ann.ask("GET", "/profile").text
    for path in (path_of(page, "ssh-keys"), path_of(page, "tokens")):
        assert admin.ask("GET", path).status_code == 404
        assert send(admin, path).status_code == 404


def test_a_token_is_shown_once_and_works_until_it_is_deleted(ann, program):
    """It is in no address, no cookie and no later page."""
    answer = send(ann, "/profile/tokens", name="notebook", days="30")
    token = answer.text.split('data-testid="secret">')[1].split("<")[0]
    assert token.startswith("rt_")
    assert token not in str(answer.headers)
    header = {"Authorization": f"Bearer {token}"}
    assert program.ask("GET", "/api/v1/me", headers=header).status_code == 200
    page = ann.ask("GET", "/profile").text
    assert token not in page
    path = path_of(page, "tokens")
    assert "Delete API token notebook?" in ann.ask("GET", path).text
    assert send(ann, path).status_code == 303
    assert program.ask("GET", "/api/v1/me", headers=header).status_code == 401
