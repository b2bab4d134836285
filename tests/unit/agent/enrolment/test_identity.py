"""Which MAC address names a robot, and that it stays the same, over made-up /sys and /proc trees."""

import pytest
from fake_root import FakeRoot
from robotether_agent.enrolment.identity import (
    Identity,
    IdentityStore,
    find_interface,
    interface_with,
)
from robotether_agent.fields import MacError, normalise_mac
from robotether_agent.problems import InterfaceMissingError
from robotether_agent.settings import Settings

WIRED, WIFI, USB = "00:1b:44:00:00:01", "b8:27:eb:00:00:02", "00:1b:44:00:00:03"


class Root(FakeRoot):
    def find(self, interface=None, *, allow_local=False):
        return find_interface(interface, allow_local=allow_local, root=self.path).mac


@pytest.fixture
def root(tmp_path):
    return Root(tmp_path)


def test_skips_what_is_no_hardware(root):
    root.add("lo", "00:00:00:00:00:00", 1, device=False, kind=772)
    root.add("docker0", "00:1b:44:00:00:01", 2, device=False)
    root.add("veth12", "00:1b:44:00:00:02", 3, device=False)
    root.add("br0", "00:1b:44:00:00:03", 4, device=False)
    root.add("tun0", "", 5, device=False, kind=65534)
    root.add("can0", "", 6, kind=280)
    root.add("wlan0", "B8:27:EB:01:02:03", 9, wireless=True)
    root.route(("tun0", 50), ("br0", 100))
    assert root.find() == "b8:27:eb:01:02:03"


def test_prefers_the_best_default_route(root):
    root.add("eth0", "00:1b:44:00:00:01", 2)
    root.add("wlan0", "00:1b:44:00:00:02", 3, wireless=True)
    root.add("wlan1", "00:1b:44:00:00:03", 4, wireless=True)
    root.route(("wlan1", 700), ("wlan0", 600))
    assert root.find() == "00:1b:44:00:00:02"


def test_knows_ipv6_default_routes(root):
    root.add("eth0", "00:1b:44:00:00:01", 2)
    root.add("wlan0", "00:1b:44:00:00:02", 3, wireless=True)
    zeros = "0" * 32
    line = (
        f"{zeros} 00 {zeros} 00 fe8000000000000000000000000000ff 00000400 1 0 00000003    wlan0\n"
    )
    other = line.replace(f"{zeros} 00", f"fe80{zeros[4:]} 40", 1).replace("wlan0", "eth0")
    (root.path / "proc/self/net/ipv6_route").write_text(other + line)
    assert root.find() == "00:1b:44:00:00:02"


def test_without_a_route_wired_comes_first_then_the_lowest_index(root):
    root.add("wlan0", "00:1b:44:00:00:01", 2, wireless=True)
    root.add("eth1", "00:1b:44:00:00:02", 4)
    root.add("eth0", "00:1b:44:00:00:03", 3)
    assert root.find() == "00:1b:44:00:00:03"


def test_locally_administered_only_when_allowed(root):
    root.add("eth0", "02:42:ac:11:00:02", 2)
    with pytest.raises(InterfaceMissingError, match=r"eth0: .* is locally administered"):
        root.find()
    assert root.find(allow_local=True) == "02:42:ac:11:00:02"


def test_a_named_interface_needs_no_hardware(root):
    root.add("eth0", "02:42:ac:11:00:02", 2, device=False)
    assert root.find("eth0", allow_local=True) == "02:42:ac:11:00:02"
    with pytest.raises(InterfaceMissingError, match=r"locally administered.*allow_local_mac"):
        root.find("eth0")
    with pytest.raises(InterfaceMissingError, match="no interface eth9"):
        root.find("eth9")


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "is not a MAC"),
        ("1b:44:11:3a:b7", "is not a MAC"),
        ("zz:1b:44:11:3a:b7", "is not a MAC"),
        ("00:00:00:00:00:00", "zero"),
        ("ff:ff:ff:ff:ff:ff", "multicast or broadcast"),
        ("01:00:5e:00:00:01", "multicast or broadcast"),
        ("02:42:ac:11:00:02", "locally administered"),
    ],
)
def test_refuses_what_names_no_robot(text, why):
    with pytest.raises(MacError, match=why):
        normalise_mac(text)


def test_a_wifi_that_shows_a_made_up_address_is_known_by_its_own(root):
    """While it looks for networks NetworkManager gives it another address every time."""
    root.add("wlan0", "b6:00:00:01:02:03", 3, wireless=True, phy80211__macaddress=WIFI)
    assert root.find() == WIFI
    assert interface_with(WIFI, root.path) == "wlan0"


def test_a_member_of_a_bond_is_known_by_its_own_address(root):
    first, second = "00:1b:44:00:00:01", "00:1b:44:00:00:02"
    root.add("bond0", second, 5, device=False)
    root.add("eth0", second, 2, bonding_slave__perm_hwaddr=first)
    root.add("eth1", second, 3, bonding_slave__perm_hwaddr=second)
    root.route(("bond0", 100))
    assert root.find() == first
    assert interface_with(first, root.path) == "eth0"


def test_hardware_comes_before_what_has_its_address(root):
    """A VLAN and a bridge have the address of the interface below; neither names a robot."""
    root.add("br0", WIFI, 1, device=False)
    root.add("eth0.10", WIFI, 2, device=False)
    assert interface_with(WIFI, root.path) == "br0"
    root.add("eth0", WIFI, 3)
    root.route(("eth0.10", 10), ("br0", 20))
    assert interface_with(WIFI, root.path) == "eth0"
    assert root.find() == WIFI
    assert interface_with("00:1b:44:00:00:09", root.path) == ""


class Machine(FakeRoot):
    def __init__(self, path):
        super().__init__(path)
        self.state = path / "state"
        self.state.mkdir()
        self.add("lo", "00:00:00:00:00:00", 1, device=False, kind=772)
        self.add("wlan0", WIFI, 3, wireless=True)
        self.route(("wlan0", 600))

    def is_now(self, enrolled=None, **settings):
        values = {"server": "a.example", "state_dir": self.state, **settings}
        return IdentityStore(Settings(**values), self.path).identity(enrolled)


@pytest.fixture
def machine(tmp_path):
    made = Machine(tmp_path)
    assert made.is_now() == Identity(WIFI, "wlan0")
    return made


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
