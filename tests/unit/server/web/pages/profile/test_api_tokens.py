"""One's own API tokens."""

from __future__ import annotations

import pytest
from admin_visitor import send
from robotether_server.db import Database
from web_visitor import Browser, bearer


@pytest.fixture
def ann(browser: Browser) -> Browser:
    """A user who is logged in."""
    browser.log_in("ann")
    return browser


def delete_path(page: str) -> str:
    """The path of the first token's deletion."""
    return "/profile/tokens/" + page.split('href="/profile/tokens/')[1].split('"', maxsplit=1)[0]


def test_a_token_is_shown_once_and_works_until_it_is_deleted(
    ann: Browser, program: Browser
) -> None:
    """It is in no address, no cookie and no later page."""
    answer = send(ann, "/profile/tokens", name="notebook", days="30")
    token = answer.text.split('data-testid="secret">')[1].split("<")[0]
    assert token.startswith("rt_")
    assert token not in str(answer.headers)
    header = {"Authorization": f"Bearer {token}"}
    assert program.ask("GET", "/api/v1/me", headers=header).status_code == 200
    page = ann.ask("GET", "/profile").text
    assert token not in page
    assert "Delete API token notebook?" in ann.ask("GET", delete_path(page)).text
    assert send(ann, delete_path(page)).status_code == 303
    assert program.ask("GET", "/api/v1/me", headers=header).status_code == 401


@pytest.mark.parametrize("wrong", [{"name": ""}, {"days": "0"}, {"days": "3651"}])
def test_a_wrong_form_comes_back(ann: Browser, wrong: dict[str, str]) -> None:
    """With the sentence, beside the form that it belongs to."""
    answer = send(ann, "/profile/tokens", **({"name": "notebook", "days": ""} | wrong))
    assert (answer.status_code, answer.text.count("form-problem")) == (422, 1)


def test_another_users_token_is_out_of_reach(ann: Browser, database: Database) -> None:
    """Even an admin's profile has the admin's own alone."""
    bearer(database, "root")
    with database.transaction() as tx:
        token_id = (tx.row("SELECT id FROM api_tokens") or {})["id"]
    assert ann.ask("GET", f"/profile/tokens/{token_id}/delete").status_code == 404
    assert send(ann, f"/profile/tokens/{token_id}/delete").status_code == 404
