"""Passwords: argon2id hashes, and the same work for users who do not exist."""

from __future__ import annotations

import pytest
from robotether_server import passwords
from robotether_server.problems import FieldInvalid


def test_right_password_matches_and_wrong_does_not() -> None:
    """The hash is argon2id."""
    hashed = passwords.hash_password("correct horse battery")
    assert hashed.startswith("$argon2id$")
    assert passwords.matches("correct horse battery", hashed)
    assert not passwords.matches("correct horse batterz", hashed)


def test_nobody_has_no_password(monkeypatch: pytest.MonkeyPatch) -> None:
    """An unknown user costs a verification of the same kind, and never matches."""
    verified: list[str] = []

    class Hasher:
        def verify(self, password_hash: str, password: str) -> None:
            verified.append(password_hash)

    monkeypatch.setattr(passwords, "_hasher", Hasher())
    assert not passwords.matches("anything", None)
    assert verified[0].split("$")[:4] == passwords._NOBODY.split("$")[:4]


def test_damaged_hash_matches_nothing() -> None:
    """A row that somebody wrote by hand does not let anybody in, nor fail the page."""
    assert not passwords.matches("anything", "plain text")


@pytest.mark.parametrize("password", ["", "x" * 11, "x" * 1025])
def test_length_has_bounds(password: str) -> None:
    """The sentence says which."""
    with pytest.raises(FieldInvalid, match="12 to 1024"):
        passwords.hash_password(password)


def test_new_passwords_are_allowed_and_differ() -> None:
    """What is generated passes its own rule."""
    made = {passwords.new_password() for _ in range(20)}
    assert len(made) == 20
    assert all(len(password) >= passwords.SHORTEST for password in made)
