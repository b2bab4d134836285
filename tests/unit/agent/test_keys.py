"""The robot's own key, made by the real ssh-keygen."""

from __future__ import annotations

import asyncio
import subprocess

import pytest
from robotether_agent.keys import ensure_key
from robotether_agent.problems import KeyUnusable, SshMissing, StateUnusable


async def test_made_once_and_kept(place):
    """The first call makes a key for its owner only, the second finds it."""
    first = await ensure_key(place)
    assert first.public.startswith("ssh-ed25519 AAAA")
    assert first.path.stat().st_mode & 0o777 == 0o600
    assert await ensure_key(place) == first
    assert sorted(path.name for path in place.iterdir()) == ["id_ed25519", "id_ed25519.pub"]


async def test_public_half_is_made_again(place):
    """A lost .pub is no loss: the private half tells it."""
    first = await ensure_key(place)
    (place / "id_ed25519.pub").unlink()
    assert await ensure_key(place) == first


async def test_fingerprint_is_ssh_keygens(place):
    """What the status shows is what `ssh-keygen -l` and the server say."""
    key = await ensure_key(place)
    command = ["ssh-keygen", "-l", "-f", str(key.path)]
    said = await asyncio.to_thread(subprocess.run, command, check=True, capture_output=True)
    assert key.fingerprint == said.stdout.decode().split()[1]


async def test_damaged_public_half_is_told(place):
    """A .pub that was cut short is key_unusable, with what to do."""
    key = await ensure_key(place)
    key.path.with_suffix(".pub").write_text(key.public[:-3])
    with pytest.raises(KeyUnusable, match="not ssh-ed25519"):
        await ensure_key(place)


async def test_open_mode_is_mended(place):
    """A key that others could read is closed, because ssh would refuse it."""
    key = await ensure_key(place)
    key.path.chmod(0o644)
    await ensure_key(place)
    assert key.path.stat().st_mode & 0o777 == 0o600


async def test_broken_and_foreign_keys_are_told(place):
    """A key that ssh-keygen cannot read, or of another type, is key_unusable with its path."""
    (place / "id_ed25519").write_text("rubbish")
    with pytest.raises(KeyUnusable, match="id_ed25519"):
        await ensure_key(place)
    (place / "id_ed25519").unlink()
    command = ["ssh-keygen", "-q", "-t", "ecdsa", "-N", "", "-f", str(place / "id_ed25519")]
    await asyncio.to_thread(subprocess.run, command, check=True, stdin=subprocess.DEVNULL)
    with pytest.raises(KeyUnusable, match="not ssh-ed25519"):
        await ensure_key(place)


async def test_nowhere_to_write(place):
    """A directory that is not there is a clear problem."""
    with pytest.raises(StateUnusable, match="cannot make the robot's key in"):
        await ensure_key(place / "none")


async def test_without_ssh_keygen(place, monkeypatch):
    """A robot without OpenSSH is told which package to install, and nothing is left half-made."""
    monkeypatch.setenv("PATH", str(place))
    with pytest.raises(SshMissing, match="openssh-client"):
        await ensure_key(place)
    assert list(place.iterdir()) == []
