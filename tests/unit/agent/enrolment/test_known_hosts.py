"""The pin of the server's SSH host keys."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from robotether_agent.enrolment.enroller import Enrolment, EnrolmentStore
from robotether_agent.enrolment.join import SshAccess
from robotether_agent.enrolment.keys import (
    ALIAS,
    HostKey,
    check_host_keys,
    parse_host_key,
    pin_host_keys,
    pinned_host_keys,
)
from robotether_agent.problems import ServerKeyChanged, StateUnusable

ED = HostKey("ssh-ed25519", "RUQx")
ED_OTHER = HostKey("ssh-ed25519", "RUQy")
RSA = HostKey("ssh-rsa", "UlNB")
PATH = Path("/state/known_hosts")
ACCESS = SshAccess("tunnel", None, (2222, 443))
ENROLMENT = Enrolment("a.example", "sim1", "00:1b:44:11:3a:b7", ACCESS)
BLOB = "AAAAC3NzaC1lZDI1NTE5AAAAIJXwzyV7Yl1cYqPGRkvnkSnMuRlWZ2EiJkXYh2JYQ0bF"
PINNED = HostKey("ssh-ed25519", BLOB)
OTHER = HostKey("ssh-ed25519", BLOB[:-2] + "aA")


def test_openssh_finds_the_pinned_key(place):
    """ssh-keygen finds the key under the alias, with the fingerprint that we print."""
    command = ["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(place / "k")]
    subprocess.run(command, check=True, stdin=subprocess.DEVNULL)
    key = parse_host_key((place / "k.pub").read_text())
    pin_host_keys(place / "known_hosts", [key])
    find = ["ssh-keygen", "-l", "-F", ALIAS, "-f", str(place / "known_hosts")]
    found = subprocess.run(find, check=True, capture_output=True, text=True).stdout
    assert key.fingerprint in found
    assert pinned_host_keys(place / "known_hosts") == [key]


@pytest.mark.parametrize(
    ("now", "trusted"),
    [
        ([ED], True),
        ([ED, RSA], True),
        ([ED_OTHER], False),
        ([ED_OTHER, RSA], False),
        ([ED, ED_OTHER], False),
        ([RSA], False),
    ],
)
def test_only_what_agrees_with_the_pin_is_trusted(now, trusted):
    """A changed key is an alarm, a key of a new type is none, and nothing in common is one."""
    if trusted:
        check_host_keys(PATH, [ED], now)
        return
    with pytest.raises(ServerKeyChanged, match="SHA256:"):
        check_host_keys(PATH, [ED], now)


@pytest.mark.parametrize("text", ["", f"{ALIAS} ssh-ed25519 %%%\n", "someone ssh-ed25519 RUQx\n"])
def test_a_broken_pin_is_not_as_good_as_none(place, text):
    """A damaged file must not make the agent trust whatever comes next."""
    (place / "known_hosts").write_text(text)
    with pytest.raises(StateUnusable, match="cannot use the pinned host keys"):
        pinned_host_keys(place / "known_hosts")


def test_other_host_keys_of_the_same_server_are_refused(place):
    """A second join changes neither pin nor enrolment when the host keys differ."""
    store = EnrolmentStore(place)
    store.keep(ENROLMENT, [PINNED])
    with pytest.raises(ServerKeyChanged):
        store.keep(Enrolment("a.example", "renamed", ENROLMENT.mac, ACCESS), [OTHER])
    assert store.load("a.example") == ENROLMENT


def test_a_broken_enrolment_keeps_the_pin(place):
    """Losing the enrolment means to join again, not to trust anew."""
    store = EnrolmentStore(place)
    store.keep(ENROLMENT, [PINNED])
    (place / "enrolment.json").write_text("{")
    assert store.load("a.example") is None
    with pytest.raises(ServerKeyChanged):
        store.keep(ENROLMENT, [OTHER])


def test_removing_known_hosts_joins_anew(place):
    """What the advice of host_key_changed says works."""
    store = EnrolmentStore(place)
    store.keep(ENROLMENT, [PINNED])
    store.known_hosts.unlink()
    assert store.load("a.example") is None
    store.keep(ENROLMENT, [OTHER])
    assert store.load("a.example") == ENROLMENT
