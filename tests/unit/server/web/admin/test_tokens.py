"""The API tokens of all users."""

from admin_visitor import send
from web_visitor import audit_kinds, bearer


def test_an_admin_deletes_a_users_token(admin, program, database):
    header = bearer(database, "ann")
    page = admin.ask("GET", "/admin/tokens").text
    path = page.split('href="/admin/tokens/')[1].split('"')[0]
    assert "API token test of ann?" in admin.ask("GET", f"/admin/tokens/{path}").text
    assert program.ask("GET", "/api/v1/me", headers=header).status_code == 200
    assert send(admin, f"/admin/tokens/{path}").location == "/admin/tokens"
    assert program.ask("GET", "/api/v1/me", headers=header).status_code == 401
    assert audit_kinds(database)[-1] == ("token_deleted", "root", "198.51.100.7")
