"""Whom the firewall admits to database and peers; tests/ansible/test_server.py and test_site.py try it itself."""

import re

import pytest
from ansible_module import ANSIBLE, play

ROLE = ANSIBLE / "roles/robotether_server"
TEMPLATE = ROLE / "templates/firewall.nft.j2"
ALONE = {
    "robotether_server_came_to": 22,
    "robotether_server_ports": [80, 443, 2222],
    "robotether_server_open_ports": [],
    "robotether_server_close_containers": True,
    "robotether_server_peers": [],
    "robotether_server_peer_ports": [8444, 3306],
    "robotether_server_settings": {},
}
STANDBY = {"DB_PARTNER": "192.0.2.9:3306"}


@pytest.mark.parametrize(
    ("changes", "admitted"),
    [
        ({}, set()),
        ({"robotether_server_peers": ["192.0.2.3", "192.0.2.2"]}, {"192.0.2.2, 192.0.2.3"}),
        ({"robotether_server_settings": STANDBY}, {"192.0.2.9"}),
    ],
)
def test_only_the_sites_machines_are_admitted(tmp_path, changes, admitted):
    write = {"src": str(TEMPLATE), "dest": str(tmp_path / "rules")}
    tasks = [{"ansible.builtin.template": write}]
    done = play(tmp_path, tasks, ROLE / "vars/main.yml", **(ALONE | changes))
    assert done.returncode == 0, done.stdout
    rules = (tmp_path / "rules").read_text()
    assert set(re.findall(r"ip saddr \{ (.*?) \}", rules)) == admitted
    assert ("dport { 8444, 3306 }" in rules) == bool(admitted)
