"""robotether user."""

from robotether_server import passwords
from robotether_server.db import users


def test_each_change_of_a_user_is_said(run, database):
    run("user", "add", "root", "--role", "admin")
    typed = "a long enough password\n"
    assert run("user", "add", "ann", "--password-stdin", stdin=typed) == (0, "added user ann\n", "")
    with database.transaction() as tx:
        assert passwords.matches("a long enough password", users.get(tx, "ann").password_hash)
    for words, said in (
        ("disable ann", "disabled user ann"),
        ("enable ann", "enabled user ann"),
        ("role ann admin", "user ann has role admin"),
        ("pools ann night crane", "user ann is in pools crane, night"),
        ("pools ann", "user ann is in no pool"),
        ("password ann --password-stdin", "user ann has a new password"),
        ("logout ann", "ended 0 logins of user ann"),
    ):
        assert run("user", *words.split(), stdin="another long password").out == said + "\n"
    with database.transaction() as tx:
        assert passwords.matches("another long password", users.get(tx, "ann").password_hash)
    assert "no terminal to ask on; say --yes" in run("user", "remove", "ann").err
    assert "did not remove user ann" in run("user", "remove", "ann", terminal="n\n").err
    assert run("user", "remove", "ann", terminal="y\n").out.endswith("removed user ann\n")
    refused = run("user", "add", "ann", "--password-stdin", stdin="short")
    assert (refused.status, refused.err.count("\n")) == (1, 1)
