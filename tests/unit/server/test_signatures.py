"""Signatures as ssh-keygen makes them hold; nothing else does."""

from __future__ import annotations

import pytest
from robot_signer import RobotSigner
from robotether_server import signatures

NAMESPACE = "robotether-rotation"
MESSAGE = "00:1b:44:11:3a:b7 ssh-ed25519 AAAA\n"


@pytest.fixture
def signer(tmp_path_factory: pytest.TempPathFactory) -> RobotSigner:
    """A robot's key."""
    return RobotSigner(tmp_path_factory.mktemp("old"))


def test_signature_of_the_key_holds(signer: RobotSigner) -> None:
    """Over this message, for this namespace."""
    signature = signer.sign(NAMESPACE, MESSAGE)
    assert signatures.holds(signer.key, NAMESPACE, MESSAGE, signature)


def test_any_other_signature_does_not(
    signer: RobotSigner, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Another message, another namespace, another key, damage, or none at all."""
    stranger = RobotSigner(tmp_path_factory.mktemp("stranger"))
    good = signer.sign(NAMESPACE, MESSAGE)
    for wrong in (
        signer.sign(NAMESPACE, MESSAGE.strip()),
        signer.sign("file", MESSAGE),
        stranger.sign(NAMESPACE, MESSAGE),
        good.replace("A", "B"),
        "\N{SNOWMAN}",
        "",
    ):
        assert not signatures.holds(signer.key, NAMESPACE, MESSAGE, wrong)
    assert not signatures.holds(stranger.key, NAMESPACE, MESSAGE, good)
