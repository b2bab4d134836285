"""One's own SSH keys."""

from __future__ import annotations

import pytest
from admin_visitor import fingerprint, public_key, send
from web_visitor import Browser


@pytest.fixture
def ann(browser: Browser) -> Browser:
    """A user who is logged in."""
    browser.log_in("ann")
    return browser


def delete_path(page: str) -> str:
    """The path of the first key's deletion."""
    return (
        "/profile/ssh-keys/" + page.split('href="/profile/ssh-keys/')[1].split('"', maxsplit=1)[0]
    )


def test_a_key_is_added_and_deleted(ann: Browser) -> None:
    """The list shows its fingerprint; the deletion asks first."""
    answer = send(ann, "/profile/ssh-keys", name="laptop", public_key=public_key(1))
    assert (answer.status_code, answer.location) == (303, "/profile#ssh-keys")
    page = ann.ask("GET", "/profile").text
    assert fingerprint(1) in page.replace("</span><span>", "")
    path = delete_path(page)
    assert "Delete SSH key laptop?" in ann.ask("GET", path).text
    assert send(ann, path).status_code == 303
    assert "You have none here yet" in ann.ask("GET", "/profile").text


def test_a_key_without_a_name_gets_its_comment(ann: Browser) -> None:
    """As people paste it."""
    send(ann, "/profile/ssh-keys", name="", public_key=public_key(1))
    assert "Delete SSH key comment" in ann.ask("GET", "/profile").text


def test_what_is_no_key_comes_back(ann: Browser) -> None:
    """With what was typed, beside the form that it belongs to."""
    answer = send(ann, "/profile/ssh-keys", name="laptop", public_key="-----BEGIN")
    assert (answer.status_code, answer.text.count("form-problem")) == (422, 1)
    assert 'value="laptop"' in answer.text
    assert "-----BEGIN</textarea>" in answer.text


def test_another_users_key_is_out_of_reach(ann: Browser) -> None:
    """Neither asked about nor deleted, as if it were not there."""
    send(ann, "/profile/ssh-keys", name="laptop", public_key=public_key(1))
    path = delete_path(ann.ask("GET", "/profile").text)
    ann.ask("POST", "/logout", data={"csrf_token": ann.csrf_of("/")})
    ann.log_in("root")
    assert ann.ask("GET", path).status_code == 404
    assert send(ann, path).status_code == 404
