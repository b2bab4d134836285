"""What stays on the robot after a join."""

from __future__ import annotations

import pytest
from robotether_agent.enrolment.enroller import Enrolment, EnrolmentStore
from robotether_agent.enrolment.join import SshAccess
from robotether_agent.enrolment.keys import HostKey
from robotether_agent.problems import ServerKeyChanged, StateUnusable

ACCESS = SshAccess("tunnel", None, (2222, 443))
ENROLMENT = Enrolment("a.example", "sim1", "00:1b:44:11:3a:b7", ACCESS)
BLOB = "AAAAC3NzaC1lZDI1NTE5AAAAIJXwzyV7Yl1cYqPGRkvnkSnMuRlWZ2EiJkXYh2JYQ0bF"
KEY = HostKey("ssh-ed25519", BLOB)
OTHER = HostKey("ssh-ed25519", BLOB[:-2] + "aA")


def test_comes_back_as_it_was_kept(place):
    """An enrolment is there after a reboot, for its server only."""
    EnrolmentStore(place).keep(ENROLMENT, [KEY])
    assert EnrolmentStore(place).load("a.example") == ENROLMENT
    assert EnrolmentStore(place).load("b.example") is None


def test_other_host_keys_of_the_same_server_are_refused(place):
    """A second join changes neither pin nor enrolment when the host keys differ."""
    store = EnrolmentStore(place)
    store.keep(ENROLMENT, [KEY])
    with pytest.raises(ServerKeyChanged):
        store.keep(Enrolment("a.example", "renamed", ENROLMENT.mac, ACCESS), [OTHER])
    assert store.load("a.example") == ENROLMENT


def test_a_broken_enrolment_keeps_the_pin(place):
    """Losing the enrolment means to join again, not to trust anew."""
    store = EnrolmentStore(place)
    store.keep(ENROLMENT, [KEY])
    (place / "enrolment.json").write_text("{")
    assert store.load("a.example") is None
    with pytest.raises(ServerKeyChanged):
        store.keep(ENROLMENT, [OTHER])


def test_another_server_in_the_settings_is_pinned_anew(place):
    store = EnrolmentStore(place)
    store.keep(ENROLMENT, [KEY])
    store.keep(Enrolment("b.example", "sim1", ENROLMENT.mac, ACCESS), [OTHER])
    assert OTHER.blob in store.known_hosts.read_text()


def test_removing_known_hosts_joins_anew(place):
    """What the advice of host_key_changed says works."""
    store = EnrolmentStore(place)
    store.keep(ENROLMENT, [KEY])
    store.known_hosts.unlink()
    assert store.load("a.example") is None
    store.keep(ENROLMENT, [OTHER])
    assert store.load("a.example") == ENROLMENT


def test_unwritable_directory_is_a_clear_problem(place):
    with pytest.raises(StateUnusable, match=r"cannot write .*known_hosts.*let the agent's user"):
        EnrolmentStore(place / "none").keep(ENROLMENT, [KEY])
