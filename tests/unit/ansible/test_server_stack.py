"""What server.yml decides by: Docker, settings and what was deployed; tests/ansible/test_server.py runs it."""

import base64
import re

import pytest
import yaml
from ansible_module import ANSIBLE, play
from commands import write_programs

pytestmark = pytest.mark.release

ROLE = ANSIBLE / "roles/robotether_server"
TASKS = ROLE / "tasks"
HEALTHY = ["nginx=healthy", "mysql=healthy"]


def task_of(name, file="stack.yml"):
    """A task of the role."""
    tasks = yaml.safe_load((TASKS / file).read_text())
    return next(task for task in tasks if task["name"] == name)


def said(folder, tasks, **given):
    """Run tasks of the role; what Ansible said."""
    return play(folder, tasks, ROLE / "vars/main.yml", **given).stdout


@pytest.mark.parametrize(
    ("active", "ufw", "sets"),
    [
        ("cron", None, True),
        ("ufw", "ENABLED=no", True),
        ("ufw", "ENABLED=yes", False),
        ("nftables", "ENABLED=no", False),
    ],
)
def test_another_firewall_stays_in_charge(tmp_path, active, ufw, sets):
    """Our rules drop what they do not know, which the other one may admit."""
    write_programs(tmp_path, {"systemctl": f'[ "$*" = "--quiet is-active {active}" ]'})
    if ufw:
        (tmp_path / "ufw.conf").write_text(f"# on or off\n{ufw}\n")
    look = task_of("Check for other firewalls", "firewall.yml")
    look["ansible.builtin.shell"] = look["ansible.builtin.shell"].replace("/etc/ufw", str(tmp_path))
    decide = task_of("Decide whether to set our own rules", "firewall.yml")
    tell = {"ansible.builtin.debug": {"msg": "sets={{ robotether_server_has_firewall | bool }}"}}
    output = said(tmp_path, [look, decide, tell], robotether_server_firewall="auto")
    assert re.findall(r"sets=(\w+)", output) == [str(sets)]


SETTINGS = """# DB_PARTNER=192.0.2.9:3306
HTTPS_PORT="8443"   # behind a proxy
SSH_PORT = 2022
  export PEER_PORT='9444'
HTTP_PORT=
DB_PARTNER=192.0.2.2:3306 # the standby
"""


def test_firewall_admits_what_the_settings_say(tmp_path):
    """They are read as compose reads them; only the site's machines reach relays and database."""
    tasks = [
        task_of("Keep the address and the published ports as facts", "settings.yml"),
        {
            "ansible.builtin.template": {
                "src": str(ROLE / "templates/firewall.nft.j2"),
                "dest": str(tmp_path / "rules"),
            }
        },
    ]
    said(
        tmp_path,
        tasks,
        robotether_server_env={"content": base64.b64encode(SETTINGS.encode()).decode()},
        robotether_server_settings={},
        robotether_server_peers=["192.0.2.3"],
        robotether_server_open_ports=[],
        robotether_server_came_to="22",
        robotether_server_close_containers=False,
    )
    rules = (tmp_path / "rules").read_text()
    assert "tcp dport { 22, 80, 2022, 8443 } accept" in rules
    assert "ip saddr { 192.0.2.2, 192.0.2.3 } tcp dport { 9444, 3306 } accept" in rules


@pytest.mark.parametrize(
    ("setting", "says"),
    [({"DB_READ_ONLY": False}, "put its value in quotes"), ({"DB_REED": "x"}, "no such setting")],
)
def test_setting_that_compose_would_take_otherwise_is_refused(tmp_path, setting, says):
    example = base64.b64encode(b"DB_READ_ONLY=OFF\n").decode()
    output = said(
        tmp_path,
        [task_of("Check that the settings named for this machine exist", "settings.yml")],
        robotether_server_settings=setting,
        robotether_server_known={"content": example},
        robotether_server_example={"stat": {"exists": True}},
    )
    assert says in " ".join(output.split())


# What was deployed, which services are healthy, and whether the database is dumped.
DEPLOYED = (
    ("", [], False),
    ("", ["mysql=starting"], False),
    ("", HEALTHY, True),
    ("older built 0", HEALTHY, True),
    ("older built 0", [], True),
    ("now built 0", HEALTHY, False),
)


def test_stack_of_before_is_dumped(tmp_path):
    """A bare machine has no database, and one that `make up` started has no record of its version."""
    decide = task_of("Decide whether to deploy")
    tell = {"ansible.builtin.debug": {"msg": "dumps={{ robotether_server_is_upgrade | bool }}"}}
    tasks = []
    for deployed, healthy, _ in DEPLOYED:
        found = {
            "robotether_server_deployed": deployed,
            "robotether_server_healthy": {"stdout_lines": healthy},
        }
        tasks += [{"ansible.builtin.set_fact": found}, decide, tell]
    given = {
        "robotether_server_code": "now built",
        "robotether_server_wanted": "now built 1",
        "robotether_server_services": ["mysql"],
    }
    output = said(tmp_path, tasks, **given)
    assert re.findall(r"dumps=(\w+)", output) == [str(dumps) for *_, dumps in DEPLOYED]
