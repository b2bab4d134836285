"""Confirmed actions: asked about first, done by a POST, told afterwards; a failure comes back with the form."""

import re

from admin_visitor import send
from robotether_server.db import robots
from web_visitor import PASSWORD, audit_kinds, paths


def test_nothing_but_a_post_changes_anything(app, admin, database):
    before = audit_kinds(database)
    for path in paths(app, "/admin", "GET") + paths(app, "/profile", "GET"):
        assert admin.ask("GET", path).status_code in (200, 302, 404, 422), path
        assert admin.ask("HEAD", path).status_code in (200, 302, 404, 422), path
    assert audit_kinds(database) == before
    with database.transaction() as tx:
        assert robots.get(tx, "sim1").state == "pending"


def test_no_action_on_what_is_not_there(app, admin):
    asked = [
        path
        for start in ("/admin", "/profile", "/robots")
        for path in paths(app, start, "POST", "ghost", "99999999")
        if "ghost" in path or "99999999" in path
    ]
    assert len(asked) > 30
    for path in asked:
        assert admin.ask("GET", path).status_code == 404, path
        assert send(admin, path, to="up").status_code == 404, path


# Forms of choices, secrets or a row of a list: there is no text to give back.
WITHOUT_TEXTS = {
    "/admin/pending",
    "/admin/robots/sim1/grants",
    "/admin/robots/sim1/region",
    "/admin/robots/sim1/site",
    "/admin/users/sim1/password",
    "/admin/users/sim1/role",
    "/profile/password",
}


def test_every_form_with_a_wrong_field_comes_back(app, admin, database):
    """The page has the sentence once, and the texts that were typed; nothing is changed."""
    for path in ("users", "groups", "sites"):  # of the robot's name, as it stands for each in paths
        send(admin, f"/admin/{path}", name="sim1", role="user", password=PASSWORD)
    send(admin, "/admin/robots/sim1/region", region="eu")
    before, wrong = audit_kinds(database), 0
    for path in paths(app, "/admin", "POST") + paths(app, "/profile", "POST"):
        page = admin.ask("GET", path).text
        names = set(re.findall(r'<(?:input|select|textarea)\b[^>]* name="(\w+)"', page))
        if typed := names - {"csrf_token", "meant"}:
            answer = send(admin, path, **dict.fromkeys(typed, "\a"))
            assert answer.status_code >= 400, path
            assert answer.text.count('data-testid="form-problem"') == 1, path
            assert ("\a" in answer.text) is (path not in WITHOUT_TEXTS), path
            wrong += 1
    assert wrong > 15
    # The present password on the profile is wrong, too.
    assert audit_kinds(database) == [*before, ("login_failed", "root", "198.51.100.7")]


def test_names_are_no_templates(admin, database):
    """Braces in what people and robots call things stay what they are."""
    send(admin, "/profile/tokens", name="{token.id}{0}")
    [path] = re.findall(r'/profile/tokens/[^"]+', admin.ask("GET", "/profile").text)
    assert "Delete API token {token.id}{0}?" in admin.ask("GET", path).text
    assert send(admin, path).status_code == 303
