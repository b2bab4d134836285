"""Passwords: argon2id hashes, and the same work for users who do not exist."""

import threading
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait

import pytest
from robotether_server import passwords
from robotether_server.problems import FieldInvalidError, ThrottledError


def test_right_password_matches_and_wrong_does_not():
    hashed = passwords.hash_password("correct horse battery")
    assert hashed.startswith("$argon2id$")
    assert passwords.matches("correct horse battery", hashed)
    assert not passwords.matches("correct horse batterz", hashed)
    # A row that somebody wrote by hand does not let anybody in, nor fail the page.
    assert not passwords.matches("anything", "plain text")


def test_nobody_has_no_password(monkeypatch):
    """An unknown user costs a verification of the same kind, and never matches."""
    verified = []

    class Hasher:
        def verify(self, password_hash, password):
            verified.append(password_hash)

    monkeypatch.setattr(passwords, "_hasher", Hasher())
    assert not passwords.matches("anything", None)
    assert verified[0].split("$")[:4] == passwords._NOBODY.split("$")[:4]


def test_a_burst_of_logins_leaves_threads_to_others(monkeypatch):
    """Two are checked and two wait; who comes then is told to come again, and does not wait with them."""
    is_over = threading.Event()

    class Hasher:
        def verify(self, _password_hash, _password):
            is_over.wait(20)

    monkeypatch.setattr(passwords, "_hasher", Hasher())
    with ThreadPoolExecutor(5) as threads:
        checks = [threads.submit(passwords.matches, "anything", "a hash") for _ in range(5)]
        try:
            refused, _ = wait(checks, 20, return_when=FIRST_COMPLETED)
            [problem] = [check.exception() for check in refused]
        finally:
            is_over.set()
    assert isinstance(problem, ThrottledError)
    assert [check.result() for check in checks if check not in refused] == [True] * 4
    # The places are free again.
    assert passwords.matches("anything", "a hash")


@pytest.mark.parametrize(
    ("password", "why"),
    [
        ("", "at least 12"),
        ("x" * 11, "at least 12"),
        ("x" * 1025, "at most 1024"),
        # As long as it may be: it is what an attacker tries first.
        ("P@ssw0rd2024!", "tried first"),
        ("qwertyuiop[]", "tried first"),
        ("1q2w3e4r5t6y", "tried first"),
        ("210987654321", "tried first"),
        ("abcabcabcabc", "tried first"),
    ],
)
def test_short_or_common_password_is_refused(password, why):
    with pytest.raises(FieldInvalidError, match=why):
        passwords.hash_password(password)


@pytest.mark.parametrize(
    "password",
    # The last is made of short common words, and can be read in very many ways.
    ["tr0ub4dor&3xyz", "passwords I made", "9f3c1e0b7a2d", "aisitoneyouyourmaymy" * 51 + "z."],
)
def test_other_password_is_taken(password):
    assert not passwords.is_common(password)
