"""Whom the firewall admits to database and peers; tests/ansible/test_server.py and test_site.py try it itself."""

import re

from ansible_module import ANSIBLE, play

ROLE = ANSIBLE / "roles/robotether_server"
TEMPLATE = ROLE / "templates/firewall.nft.j2"
MACHINE = {
    "robotether_server_came_to": 22,
    "robotether_server_ports": [80, 443, 2222],
    "robotether_server_open_ports": [],
    "robotether_server_close_containers": True,
    "robotether_server_peer_ports": [8444, 3306],
}
# Peers, settings, and the addresses that are admitted.
SITES = (
    ([], {}, set()),
    (["192.0.2.3", "192.0.2.2"], {}, {"192.0.2.2, 192.0.2.3"}),
    ([], {"DB_PARTNER": "192.0.2.9:3306"}, {"192.0.2.9"}),
)


def test_only_the_sites_machines_are_admitted(tmp_path):
    tasks = [
        {
            "ansible.builtin.template": {"src": str(TEMPLATE), "dest": f"{tmp_path}/{number}"},
            "vars": {"robotether_server_peers": peers, "robotether_server_settings": settings},
        }
        for number, (peers, settings, _) in enumerate(SITES)
    ]
    done = play(tmp_path, tasks, ROLE / "vars/main.yml", **MACHINE)
    assert done.returncode == 0, done.stdout
    for number, (_, _, admitted) in enumerate(SITES):
        rules = (tmp_path / str(number)).read_text()
        assert set(re.findall(r"ip saddr \{ (.*?) \}", rules)) == admitted
        assert ("dport { 8444, 3306 }" in rules) == bool(admitted)
