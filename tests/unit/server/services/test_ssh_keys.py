"""People's SSH keys, and the entries for their ssh."""

import datetime as dt
import subprocess

import pytest
from granted import give
from joins import OTHER_MAC
from relay_server import cell_settings
from robot_signer import RobotSigner
from robotether_server.db import cells, fleet, robots, users
from robotether_server.db.audit import Source
from robotether_server.db.fleet import SessionEntry
from robotether_server.problems import (
    NotPossibleError,
    RecordMissingError,
)
from robotether_server.services import ssh_keys
from robotether_server.services.ssh_keys import ShellEntry

ANN = Source("ann")


def test_other_peoples_keys_are_out_of_reach_and_ones_own_bounded(site, monkeypatch):
    """The numbers of others' keys are as unknown as those of no key."""
    with site.database.transaction() as tx:
        ann, root = users.get(tx, "ann"), users.get(tx, "root")
        key = ssh_keys.add(tx, ANN, ann, "desk", RobotSigner().line)
        with pytest.raises(RecordMissingError):
            ssh_keys.delete(tx, Source("root"), root, key.id)
        monkeypatch.setattr(ssh_keys, "MAX_KEYS", 1)
        with pytest.raises(NotPossibleError, match="delete one"):
            ssh_keys.add(tx, ANN, ann, "laptop", RobotSigner().line)


ENTRY = ShellEntry("sim1", 24000, None)


def test_entries_are_the_shells_that_one_manages(site):
    site.announce("waits", OTHER_MAC)
    with site.database.transaction() as tx:
        ann, root = users.get(tx, "ann"), users.get(tx, "root")
        sim1 = robots.get(tx, "sim1").id
        assert ssh_keys.shell_entries(tx, root) == []
        robots.set_shell(tx, sim1, on=True)
        robots.set_shell(tx, robots.get(tx, "waits").id, on=True)
        assert ssh_keys.shell_entries(tx, root) == [ENTRY]
        give(tx, ann.id, sim1, "drive")
        assert ssh_keys.shell_entries(tx, ann) == []
        give(tx, ann.id, sim1, "manage")
        robots.set_settings(tx, sim1, {"shell_user": "pi"})
        assert ssh_keys.shell_entries(tx, ann) == [ShellEntry("sim1", 24000, "pi")]
        for wrong in ("pi\n    ProxyCommand sh", 5, None):
            robots.set_settings(tx, sim1, {"shell_user": wrong})
            assert ssh_keys.shell_entries(tx, ann) == [ENTRY]


def test_an_entry_leads_to_the_machine_where_the_robot_is(site, relay_database):
    with site.database.transaction() as tx:
        root, sim1 = users.get(tx, "root"), robots.get(tx, "sim1").id
        robots.set_shell(tx, sim1, on=True)
    for name in ("a", "b"):
        with relay_database.transaction() as tx:
            now, cell = dt.datetime.now(dt.UTC), cell_settings(name, f"{name}.example")
            cells.write_heartbeat(tx, cell, cells.CellCounts(), now)
            fleet.write(tx, [SessionEntry(sim1, now, "192.0.2.1")], name)
    with site.database.transaction() as tx:
        text = ssh_keys.render_config(ssh_keys.shell_entries(tx, root), "a.example", 2222)
    assert "ProxyJump jump@b.example:2222" in text


@pytest.mark.parametrize("host", ["cloud.example", "192.0.2.1", "2001:db8::1"])
def test_ssh_understands_what_is_rendered(tmp_path, host):
    file = tmp_path / "config"
    entries = [ENTRY, ShellEntry("turtle", 24001, "pi")]
    own = "Host *\n    ControlMaster auto\n    ControlPath /tmp/%C\n"
    file.write_text(ssh_keys.render_config(entries, host, 2222) + own)
    assert file.read_text().startswith(
        "Host sim1\n    HostName 127.0.0.1\n    Port 24000\n    HostKeyAlias robotether-sim1\n"
    )
    for name, expected in (
        ("sim1", {"port 24000", "hostkeyalias robotether-sim1"}),
        ("turtle", {"port 24001", "user pi"}),
    ):
        command = ["ssh", "-F", file, "-G", name]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        # Some versions write brackets around an IPv4 address too.
        lines = done.stdout.replace("[", "").replace("]", "").splitlines()
        assert expected | {"hostname 127.0.0.1"} <= set(lines)
        assert f"proxyjump jump@{host}:2222" in lines
        assert not [line for line in lines if line.startswith("controlpath ")]
