"""What agent and server agree on at a join."""

from robotether_common.join import ROTATION_NAMESPACE, rotation_message


def test_what_the_old_key_signs():
    """An agent and a server of different versions must mean the same text."""
    assert ROTATION_NAMESPACE == "robotether-rotation"
    assert rotation_message("00:1b:44:11:3a:b7", "ssh-ed25519 AAAA") == (
        "00:1b:44:11:3a:b7 ssh-ed25519 AAAA\n"
    )
