"""A robot stays who it is while its interfaces come and go, over made-up /sys trees."""

from __future__ import annotations

from pathlib import Path

import pytest
from fake_root import FakeRoot
from robotether_agent.enrolment.identity import Identity, IdentityStore
from robotether_agent.settings import Settings

WIRED, WIFI, USB = "00:1b:44:00:00:01", "b8:27:eb:00:00:02", "00:1b:44:00:00:03"


class Machine(FakeRoot):
    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.state = path / "state"
        self.state.mkdir()
        self.add("lo", "00:00:00:00:00:00", 1, device=False, kind=772)
        self.add("wlan0", WIFI, 3, wireless=True)
        self.route(("wlan0", 600))

    def is_now(self, enrolled: str | None = None, **settings: object) -> Identity:
        values = {"server": "a.example", "state_dir": self.state, **settings}
        return IdentityStore(Settings(**values), self.path).identity(enrolled)


@pytest.fixture
def machine(tmp_path) -> Machine:
    made = Machine(tmp_path)
    assert made.is_now() == Identity(WIFI, "wlan0")
    return made


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
    machine.remove("wlan0")
    machine.add("wlan1", WIFI, 5, wireless=True)
    assert machine.is_now() == Identity(WIFI, "wlan1")


def test_a_card_that_went_away_leaves_the_robot_what_it_is(machine):
    machine.remove("wlan0")
    machine.add("eth0", WIRED, 2)
    assert machine.is_now() == Identity(WIFI, "wlan0", is_present=False)
    machine.add("wlan0", WIFI, 7)
    assert machine.is_now().is_present


def test_a_replaced_card_under_the_same_name_is_no_other_robot(machine):
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
    assert machine.is_now(interface="eth0") == Identity(WIFI, "wlan0")
    machine.add("eth0", WIRED, 2)
    assert machine.is_now(interface="eth0") == Identity(WIRED, "eth0")
    machine.remove("eth0")
    assert machine.is_now() == Identity(WIRED, "eth0", is_present=False)


def test_a_robot_whose_file_is_lost_keeps_the_mac_of_its_enrolment(tmp_path):
    machine = Machine(tmp_path)
    machine.add("eth0", WIRED, 2)
    assert machine.is_now(enrolled=WIRED) == Identity(WIRED, "eth0")
    assert machine.is_now() == Identity(WIRED, "eth0")


def test_a_broken_file_is_found_anew(machine):
    (machine.state / "identity.json").write_text('{"mac": "rubb')
    assert machine.is_now() == Identity(WIFI, "wlan0")
