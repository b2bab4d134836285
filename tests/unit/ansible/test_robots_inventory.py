"""The inventory of a server's robots, as Ansible reads it from the real application."""

import hashlib
import json
import os
import ssl
import sys
from pathlib import Path

import pytest
import yaml
from api_visitor import new_public_key
from commands import run_command

ANSIBLE = Path(__file__).resolve().parents[3] / "ansible"
MACS = {
    name: f"00:1b:44:00:00:0{number}" for number, name in enumerate(("turtle", "rover", "scout"), 1)
}


@pytest.fixture
def fleet(web, admin_database):
    """Turtle is online at a site and opens shells, rover is disabled, scout offline; two groups have grants."""
    root = web.program("root")

    def ask(method, path, **body):
        answer = root.ask(method, path, body)
        assert answer.status_code in {200, 201}, answer.text

    for name, mac in MACS.items():
        report = {"hostname": f"{name}-pc", "agent_version": "0.1.0"}
        ask("PUT", f"/robots/{name}", mac=mac, public_key=new_public_key(), **report)
    ask("POST", "/sites", name="north-hall")
    ask("PATCH", "/robots/turtle", site="north-hall", shell=True, settings={"shell_user": "pi"})
    ask("PATCH", "/robots/rover", state="disabled", shell=True)
    for group, to in (
        ("ops", {"site": "north-hall"}),
        ("r.and-d", {"all": True}),
        ("past", {"all": True}),
    ):
        ask("POST", "/groups", name=group)
        ask("POST", "/grants", group=group, level="drive", **to)
    ask("PUT", "/grants/ann/turtle", level="observe")
    with admin_database.transaction() as tx:
        tx.change(
            "INSERT INTO robot_sessions (robot_id, address) "
            "SELECT id, '192.0.2.1' FROM robots WHERE name = 'turtle'"
        )
        tx.change(
            "UPDATE grants SET expires_at = '2026-01-01' "
            "WHERE group_id = (SELECT id FROM user_groups WHERE name = 'past')"
        )
    return web


@pytest.fixture
def listed(fleet, tmp_path):
    """What ansible-inventory lists of a file with these options."""

    def read(user="root", **options):
        done = run(fleet, tmp_path, user, **options)
        assert done.returncode == 0, done.stderr
        assert "WARNING" not in done.stderr, done.stderr
        return json.loads(done.stdout, object_hook=_plain)

    return read


def run(web, folder, user="root", **options):
    """Run ansible-inventory on a file with these options; None takes one out."""
    file = folder / "fleet.yml"
    known = {"server": web.address, "ca_file": str(web.certificate), **options}
    written = {name: value for name, value in known.items() if value is not None}
    file.write_text(yaml.safe_dump({"plugin": "robotether.robotether.robots", **written}))
    environ = {
        **os.environ,
        "ANSIBLE_CONFIG": str(ANSIBLE / "ansible.cfg"),
        "ANSIBLE_INVENTORY_UNPARSED_FAILED": "yes",
        "ANSIBLE_NOCOLOR": "1",
        "ROBOTETHER_TOKEN": web.token(user),
    }
    program = Path(sys.executable).with_name("ansible-inventory")
    return run_command(program, "-i", file, "--list", env=environ)


def _plain(found):
    """A text that is not a template, without Ansible's mark of that."""
    return found.get("__ansible_unsafe", found)


def groups_of(found):
    """The hosts of each group that has some."""
    return {name: sorted(item["hosts"]) for name, item in found.items() if "hosts" in item}


def test_robots_have_their_sites_states_and_shells(listed, fleet):
    """All are in the group with which the playbooks work; a group's name has no hyphen.

    Shells go through the server, with what `robotether ssh-config` says; a robot without a shell for this user has
    nothing of it.
    """
    found = listed()
    assert groups_of(found) == {
        "robots": ["rover", "scout", "turtle"],
        "site_north_hall": ["turtle"],
        "state_online": ["turtle"],
        "state_offline": ["scout"],
        "state_disabled": ["rover"],
    }
    variables = found["_meta"]["hostvars"]
    turtle = variables["turtle"]
    # Of another server's robot with the same port and user, Ansible shares no connection.
    server = fleet.address.replace("127.0.0.1", "localhost")
    elsewhere = listed(server=server)["_meta"]["hostvars"]["turtle"]
    assert turtle.pop("ansible_control_path") != elsewhere["ansible_control_path"]
    assert turtle["robot_mac"] == MACS["turtle"]
    assert turtle["robot_site"] == "north-hall"
    assert turtle["robot_online"] is True
    assert turtle["robot_address"] == "192.0.2.1"
    assert turtle["robot_agent_version"] == "0.1.0"
    entry = dict(
        line.split() for line in fleet.program("root").ask("GET", "/ssh-config").text.splitlines()
    )
    assert {name: value for name, value in turtle.items() if "ansible" in name} == {
        "ansible_host": "127.0.0.1",
        "ansible_port": int(entry["Port"]),
        "ansible_user": "pi",
        "ansible_ssh_common_args": "-o ProxyJump=jump@127.0.0.1:2222 -o HostKeyAlias=robotether-turtle",
    }
    for other in ("scout", "rover"):
        assert not [name for name in variables[other] if name.startswith("ansible")]


# What Ansible takes for this machine, or in place of a group.
TAKEN = ("localhost", "robots", "all")


def test_groups_server_and_pin_are_there_and_no_robot_takes_the_place_of_others(fleet, tmp_path):
    """User groups are those with a grant; a pinned certificate needs no authority; `jump: false` leaves shells out.

    Whoever has a join token chooses a robot's name. What the roles do on this machine has an admin's token, and with a
    robot of the group's name the playbooks would work on that one alone.
    """
    for number, name in enumerate(TAKEN):
        body = {"mac": f"00:1b:44:00:00:1{number}", "public_key": new_public_key()}
        assert fleet.program("root").ask("PUT", f"/robots/{name}", body).status_code == 201
    grant = {"group": "r_and_d", "level": "observe", "robot": "turtle"}
    for path, body in (("groups", {"name": "r_and_d"}), ("grants", grant)):
        assert fleet.program("root").ask("POST", f"/{path}", body).status_code == 201
    der = ssl.PEM_cert_to_DER_cert(fleet.certificate.read_text().partition("-----BEGIN PRIV")[0])
    pin = hashlib.sha256(der).hexdigest()
    options = {"group_by": ["group"], "ca_file": None, "tls_fingerprint": pin, "jump": False}
    done = run(fleet, tmp_path, **options)
    said = " ".join(done.stderr.split())
    assert all(f"left the robot {name} out" in said for name in TAKEN)
    assert "group_r.and-d and group_r_and_d are both the group group_r_and_d" in said
    found = json.loads(done.stdout, object_hook=_plain)
    assert groups_of(found) == {
        "robots": ["rover", "scout", "turtle"],
        "group_ops": ["turtle"],
        "group_r_and_d": ["rover", "scout", "turtle"],
    }
    turtle = found["_meta"]["hostvars"]["turtle"]
    assert turtle["robot_groups"] == ["ops", "r.and-d", "r_and_d"]
    assert turtle["robotether_agent_server"] == fleet.address
    assert turtle["robotether_agent_tls_fingerprint"] == pin
    assert not [name for name in turtle if name.startswith("ansible")]


def test_user_sees_what_the_api_shows(listed):
    found = listed("ann")
    assert groups_of(found)["robots"] == ["turtle"]
    turtle = found["_meta"]["hostvars"]["turtle"]
    assert turtle["robot_level"] == "observe"
    assert not {"robot_hostname", "robot_address", "ansible_host"} & set(turtle)


@pytest.mark.parametrize(
    ("user", "options", "says"),
    [
        ("root", {"ca_file": None}, "set tls_fingerprint to the SHA-256 that the server printed"),
        ("root", {"tls_fingerprint": "ab" * 32}, "but tls_fingerprint is abab"),
        ("ann", {"group_by": ["group"]}, "use an API token of a user with role admin [grant_missing]"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said(fleet, tmp_path, user, options, says):
    done = run(fleet, tmp_path, user, **options)
    assert done.returncode != 0
    assert says in " ".join(done.stderr.split())
    assert "rt_" not in done.stderr
