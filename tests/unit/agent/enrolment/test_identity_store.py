"""A robot stays who it is while its interfaces come and go, over made-up /sys trees."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from fake_root import FakeRoot
from robotether_agent.enrolment.identity import Identity, IdentityStore
from robotether_agent.settings import Settings

WIRED, WIFI, USB = "00:1b:44:00:00:01", "b8:27:eb:00:00:02", "00:1b:44:00:00:03"


class Machine(FakeRoot):
    """A machine with a wired and a wireless interface, and the agent's disk."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.state = path / "state"
        self.state.mkdir()
        self.add("lo", "00:00:00:00:00:00", 1, device=False, kind=772)
        self.add("wlan0", WIFI, 3, wireless=True)
        self.route(("wlan0", 600))

    def is_now(self, enrolled: str | None = None, **settings: object) -> Identity:
        """Who the robot is after a restart with these settings."""
        values = {"server": "a.example", "state_dir": self.state, **settings}
        return IdentityStore(Settings(**values), self.path).identity(enrolled)


@pytest.fixture
def machine(tmp_path) -> Machine:
    """A robot that found its wireless interface at its first start."""
    made = Machine(tmp_path)
    assert made.is_now() == Identity(WIFI, "wlan0")
    return made


def test_what_was_found_first_is_kept(machine):
    """The file says which interface, for a person who wonders."""
    kept = json.loads((machine.state / "identity.json").read_text())
    assert kept == {"interface": "wlan0", "mac": WIFI}


@pytest.mark.parametrize(
    ("name", "mac", "device"),
    [
        ("eth0", WIRED, True),
        ("wlx001b44000003", USB, True),
        ("docker0", "00:1b:44:00:00:04", False),
        ("wg0", "", False),
        ("br0", "00:1b:44:00:00:05", False),
        ("bond0", "00:1b:44:00:00:06", False),
        ("wlan0.10", WIFI, False),
    ],
)
def test_interfaces_that_come_change_nothing(machine, name, mac, device):
    machine.add(name, mac, 2, device=device)
    machine.route((name, 1), ("wlan0", 600))
    assert machine.is_now() == Identity(WIFI, "wlan0")


def test_the_same_hardware_under_another_name_is_there(machine):
    """The kernel may number interfaces in another order after an update."""
    machine.remove("wlan0")
    machine.add("wlan1", WIFI, 5, wireless=True)
    assert machine.is_now() == Identity(WIFI, "wlan1")


def test_a_card_that_went_away_leaves_the_robot_what_it_is(machine):
    """Another card gives it no other name; that the MAC is gone is known, until it is back."""
    machine.remove("wlan0")
    machine.add("eth0", WIRED, 2)
    assert machine.is_now() == Identity(WIFI, "wlan0", is_present=False)
    machine.add("wlan0", WIFI, 7)
    assert machine.is_now().is_present


def test_a_replaced_card_under_the_same_name_is_no_other_robot(machine):
    """Also when the settings name the interface: only its hardware has changed."""
    machine.remove("wlan0")
    machine.add("wlan0", USB, 3, wireless=True)
    expected = Identity(WIFI, "wlan0", is_present=False)
    assert machine.is_now() == expected
    assert machine.is_now(interface="wlan0") == expected


def test_the_setting_mac_wins(machine):
    """A person who names an address gets that one, whether this machine has it or not; nothing is kept."""
    assert machine.is_now(mac=USB) == Identity(USB, "")
    machine.add("eth0", WIRED, 2)
    assert machine.is_now(mac=WIRED) == Identity(WIRED, "eth0")
    assert machine.is_now() == Identity(WIFI, "wlan0")


def test_the_setting_interface_wins_once_it_is_there(machine):
    """A person who names another interface gets its address, and that one is kept from then on."""
    assert machine.is_now(interface="eth0") == Identity(WIFI, "wlan0")
    machine.add("eth0", WIRED, 2)
    assert machine.is_now(interface="eth0") == Identity(WIRED, "eth0")
    machine.remove("eth0")
    assert machine.is_now() == Identity(WIRED, "eth0", is_present=False)


def test_a_robot_whose_file_is_lost_keeps_the_mac_of_its_enrolment(tmp_path):
    """A full disk may have kept it from being written, too."""
    machine = Machine(tmp_path)
    machine.add("eth0", WIRED, 2)
    assert machine.is_now(enrolled=WIRED) == Identity(WIRED, "eth0")
    assert machine.is_now() == Identity(WIRED, "eth0")


def test_a_broken_file_is_found_anew(machine):
    """A file that a power cut spoilt is as good as none."""
    (machine.state / "identity.json").write_text('{"mac": "rubb')
    assert machine.is_now() == Identity(WIFI, "wlan0")


def test_looking_keeps_nothing(tmp_path):
    """The doctor may look at a robot that nobody has started yet."""
    machine = Machine(tmp_path)
    settings = Settings(server="a.example", state_dir=machine.state)
    store = IdentityStore(settings, machine.path, keeps=False)
    found = store.identity()
    assert found == Identity(WIFI, "wlan0")
    assert not store.is_kept(found)
    assert machine.is_now() == found
    assert store.is_kept(found)
