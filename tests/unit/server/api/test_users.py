"""Users, as admins see and change them."""

from robotether_server import passwords
from robotether_server.db import users


def matches(database, user, password):
    with database.transaction() as tx:
        return passwords.matches(password, users.get(tx, user).password_hash)


def test_password_that_is_made_is_told_once(root, database):
    answer = root.ask("POST", "/users", {"name": "eve", "role": "user"})
    assert answer.status_code == 201
    made = answer.json["password"]
    assert answer.json == {"name": "eve", "role": "user", "disabled": False, "password": made}
    assert matches(database, "eve", made)
    given = "  spaces count, twelve"
    answer = root.ask("POST", "/users", {"name": "max", "role": "admin", "password": given})
    assert answer.json == {"name": "max", "role": "admin", "disabled": False}
    assert matches(database, "max", given)


def test_removed_user_is_out(root, ann):
    assert root.ask("DELETE", "/users/ann").status_code == 204
    assert ann.refused("GET", "/me") == (401, "token_invalid")
    assert root.refused("DELETE", "/users/ann") == (404, "record_missing")
