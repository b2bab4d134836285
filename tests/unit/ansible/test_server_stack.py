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


def test_room_is_needed_where_docker_is(tmp_path):
    """Its folder may be on another file system than the rest, such as one that has no room."""
    write_programs(tmp_path, {"docker": "echo /proc/self"})
    names = ("Find how much room Docker has", "Check that there is room for the images")
    output = said(tmp_path, [task_of(name, "preflight.yml") for name in names])
    assert "cannot set up localhost: /proc/self has 0 GB free, and 4 GB are needed" in output


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


@pytest.mark.parametrize(
    ("text", "settings", "address"),
    [
        ("", {}, "https://127.0.0.1/"),
        ("PUBLIC_HOST=\nHTTPS_PORT=8443\n", {}, "https://127.0.0.1:8443/"),
        ("HTTPS_PORT=8443\nPUBLIC_PORT=443\n", {"PUBLIC_HOST": "a.example"}, "https://a.example/"),
        ("DOMAIN=b.example\nPUBLIC_PORT=\n", {"PUBLIC_PORT": 4443}, "https://b.example:4443/"),
    ],
)
def test_address_is_the_one_in_force(tmp_path, text, settings, address):
    """It is printed at the end: behind another machine's port, or with the certificate's name."""
    keep = task_of("Keep the address and the published ports as facts", "settings.yml")
    tell = task_of("Print address, user and fingerprint", "print_address.yml")
    given = {
        "robotether_server_env": {"content": base64.b64encode(text.encode()).decode()},
        "robotether_server_settings": settings,
        "robotether_server_secrets_from": "",
        "robotether_server_folder": "/opt/robotether",
        "robotether_server_fingerprint": {"stdout": "sha256 Fingerprint=AA"},
    }
    assert f'"open      {address}"' in said(tmp_path, [keep, tell], **given)


@pytest.mark.parametrize(
    ("deployed", "healthy", "dumps"),
    [
        ("", [], False),
        ("", ["mysql=starting"], False),
        ("", HEALTHY, True),
        ("older built 0", HEALTHY, True),
        ("older built 0", [], True),
        ("now built 0", HEALTHY, False),
    ],
)
def test_stack_of_before_is_dumped(tmp_path, deployed, healthy, dumps):
    """A bare machine has no database, and one that `make up` started has no record of its version."""
    tell = {"ansible.builtin.debug": {"msg": "dumps={{ robotether_server_is_upgrade | bool }}"}}
    given = {
        "robotether_server_deployed": deployed,
        "robotether_server_code": "now built",
        "robotether_server_wanted": "now built 1",
        "robotether_server_services": ["mysql"],
        "robotether_server_healthy": {"stdout_lines": healthy},
    }
    output = said(tmp_path, [task_of("Decide whether to deploy"), tell], **given)
    assert re.findall(r"dumps=(\w+)", output) == [str(dumps)]


@pytest.mark.parametrize(
    ("deployed", "kept", "loads"),
    [
        ("now 0a1b 0", "mysql web", False),
        ("now 0a1b 0", "mysql", True),
        ("older 9f9f 0", "mysql web", True),
        ("", "", True),
    ],
)
def test_images_are_loaded_where_they_are_not(tmp_path, deployed, kept, loads):
    """Also those of the archive that was loaded last: `docker image prune --all` may have removed them."""
    lists = '[ "$*" = "config --images" ] && printf "mysql\\nweb\\n"'
    write_programs(tmp_path / "tools", {"compose": lists})
    has_all = (
        f'for image in "$@"; do case " inspect {kept} " in *" $image "*) ;; *) exit 1 ;; esac; done'
    )
    write_programs(tmp_path, {"docker": f"shift; {has_all}"})
    load = task_of("Load the images from the archive")
    tell = {"ansible.builtin.debug": {"msg": "it loads"}, "when": load["when"]}
    given = {
        "robotether_server_deployed": deployed,
        "robotether_server_folder": str(tmp_path),
        "robotether_server_archive": {"stat": {"checksum": "0a1b"}},
    }
    output = said(tmp_path, [task_of("Check that Docker has the images"), tell], **given)
    assert ("it loads" in output) == loads
