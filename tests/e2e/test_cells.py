"""Two cells of one site: one database over TLS, one set of secrets, and robots that move from one to the other."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from http import HTTPStatus
from pathlib import Path
from typing import Any

import pytest
from cells import first_cell, second_cell
from inside import run_inside
from jump_people import end
from robot_key import RobotKey, session_line
from stack import Stack


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """The cell with the database and three robots."""
    cell = first_cell(tmp_path_factory.mktemp("site"))
    try:
        cell.up()
        yield cell
    finally:
        cell.down()


@pytest.fixture(scope="module")
def second(first: Stack) -> Iterator[Stack]:
    """The other cell."""
    with second_cell(first) as cell:
        yield cell


def cells_by(cell: Stack) -> dict[str, dict[str, Any]]:
    """The cells of the site, as this one lists them."""
    return {one["name"]: one for one in json.loads(cell.robotether("cell", "list", "--json"))}


def test_both_cells_are_listed_and_serve_pages(first: Stack, second: Stack) -> None:
    """By each of them, with the addresses at which robots reach them."""
    for cell in (first, second):
        cell.wait(
            "both cells alive",
            lambda cell=cell: [one["is_alive"] for one in cells_by(cell).values()] == [True, True],
            "relay",
        )
        listed = cells_by(cell)
        assert {name: one["host"] for name, one in listed.items()} == dict.fromkeys(
            ("a", "b"), first.settings["PUBLIC_HOST"]
        )
        assert [listed[name]["https_port"] for name in ("a", "b")] == [
            first.https_port,
            second.https_port,
        ]
        assert cell.request("GET", "/login")[0] == HTTPStatus.OK


def host_key(cell: Stack) -> str:
    return cell.exec("sshd", "cat", "/etc/ssh/public/ssh_host_ed25519_key.pub").split()[1]


def test_cells_are_one_site(first: Stack, second: Stack) -> None:
    """People, robots and the SSH host key are the same at both."""
    first.robotether("user", "add", "ann")
    assert "ann" in second.robotether("user", "list")
    assert host_key(first) == host_key(second)
    token = {"Authorization": f"Bearer {first.token('cells')}"}
    for cell in (first, second):
        status, robots = cell.request("GET", "/api/v1/robots", headers=token)
        assert status == HTTPStatus.OK
        assert {robot["name"] for robot in robots["robots"]} == {"sim1", "sim2", "sim3"}


def test_secrets_are_exported_for_their_owner_alone(second: Stack) -> None:
    folder = second.folder / "secrets"
    assert folder.stat().st_mode & 0o777 == 0o700
    assert {file.stat().st_mode & 0o077 for file in folder.iterdir()} == {0}


def test_migrations_run_from_a_cell_too(second: Stack) -> None:
    """For a database that no machine of the site has."""
    assert "nothing was missing" in second.compose("run", "--rm", "--no-TTY", "migrate")


def test_key_look_up_works_at_both(first: Stack, second: Stack) -> None:
    """By TLS, and with the program of people's keys too, which asks by another client."""
    [[fingerprint]] = first.sql("SELECT fingerprint FROM tunnel_keys LIMIT 1")
    for cell in (first, second):
        done = run_inside(
            cell.container("sshd"),
            *("/usr/lib/robotether/authorized-keys", "tunnel", fingerprint, "192.0.2.7 1 2 3"),
            user="keylookup",
        )
        assert (done.returncode, done.stdout[:9]) == (0, "restrict,")
        assert "jump-watch" not in cell.logs("sshd")


def test_robot_that_joins_at_one_cell_may_connect_to_both(
    first: Stack, second: Stack, tmp_path: Path
) -> None:
    """Its answer names both, and each lets its key in."""
    mac = "00:00:5e:00:53:70"
    key = RobotKey(second, tmp_path, "roamer")
    second.robotether("robot", "add", "roamer", "--mac", mac)
    key.join(mac)
    second.robotether("robot", "approve", "roamer", "--yes")
    status, answer = key.join(mac)
    assert status == HTTPStatus.OK
    ssh: Any = answer["ssh"]
    assert sorted(cell["ports"][0] for cell in ssh["cells"]) == sorted(
        [first.ssh_port, second.ssh_port]
    )
    for cell in ssh["cells"]:
        session = key.start("tunnel@127.0.0.1", "session", port=cell["ports"][0])
        try:
            assert session_line(session)["robot"] == "roamer"
        finally:
            end(session)
    second.admin.remove("robots", "roamer")


def test_database_takes_no_connection_without_tls(first: Stack, second: Stack) -> None:
    """Whoever reads the network between the machines sees no record."""
    host, port = first.settings["DB_HOST"], first.settings["DB_PORT"]
    command = ["mariadb", f"--host={host}", f"--port={port}", "--user=keylookup", "--skip-ssl"]
    read = 'MYSQL_PWD=$(cat /run/secrets/mysql_keylookup_password) exec "$@"'
    done = run_inside(
        second.container("sshd"),
        "sh",
        "-c",
        read,
        "sh",
        *command,
        "-e",
        "SELECT 1",
        user="keylookup",
    )
    assert done.returncode != 0
    assert "secure transport" in done.stderr


@contextmanager
def machine_down(cell: Stack) -> Iterator[None]:
    """The machine is away inside the block, without a word, and boots after it."""
    containers = [cell.container(name) for name in ("nginx", "web", "relay", "sshd", "mysql")]
    for container in containers:
        container.kill()
    try:
        yield
    finally:
        for container in reversed(containers):
            container.start()
        cell.wait_healthy("mysql")
        cell.wait_healthy("relay")


def robots_at(cell: Stack) -> int:
    """How many are online there, as its relay counts them, which needs no database."""
    read = "import urllib.request as r; print(r.urlopen('http://127.0.0.1:9100/metrics').read().decode())"
    [line] = [
        one
        for one in cell.exec("relay", "python3", "-c", read).splitlines()
        if one.startswith("robotether_relay_robots_online ")
    ]
    return round(float(line.split()[1]))


def test_robots_of_a_machine_that_died_go_to_the_other(first: Stack, second: Stack) -> None:
    """Although the database died with it, and stay where they are when it is back."""
    robots = ("sim1", "sim2", "sim3")
    # By itself within a minute.
    second.exec("sshd", "/usr/lib/robotether/authorized-keys", "cache", user="keylookup")
    with machine_down(first):
        second.wait(
            "all robots", lambda: robots_at(second) == len(robots), "relay", "sshd", seconds=60
        )
    for robot in robots:
        second.wait(f"{robot} recorded", lambda robot=robot: second.online(robot), "relay", "web")
    assert robots_at(second) == len(robots)
