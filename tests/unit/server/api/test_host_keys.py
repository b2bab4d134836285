"""sshd's public host keys, read from its volume."""

from __future__ import annotations

from pathlib import Path

import pytest
from robotether_server.api import host_keys
from robotether_server.problems import StoreUnavailable


def test_public_keys_are_read_without_their_comments(tmp_path: Path) -> None:
    """By file name, and only *.pub."""
    (tmp_path / "b.pub").write_text("ssh-rsa BBBB root@x\n")
    (tmp_path / "a.pub").write_text("ssh-ed25519 AAAA\n")
    (tmp_path / "a").write_text("PRIVATE")
    assert host_keys.read(tmp_path) == ["ssh-ed25519 AAAA", "ssh-rsa BBBB"]


@pytest.mark.parametrize("name", ["empty.pub", "other.txt"])
def test_no_key_yet_is_said_so(tmp_path: Path, name: str) -> None:
    """A robot must not be told to trust nothing."""
    (tmp_path / name).write_text("")
    with pytest.raises(StoreUnavailable, match="host keys"):
        host_keys.read(tmp_path)
