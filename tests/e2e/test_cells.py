"""Two cells of one site: one database over TLS, one set of secrets, and robots that move from one to the other."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from cells import first_cell, second_cell
from inside import run_inside
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
        assert status == 200
        assert {robot["name"] for robot in robots["robots"]} == {"sim1", "sim2", "sim3"}


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
