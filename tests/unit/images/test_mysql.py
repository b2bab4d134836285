"""The mysql image: what its entrypoint does with secrets and volumes, and what the server says is in force."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import docker
import mariadb_server
import pytest
from docker.models.containers import Container
from inside import run_inside
from mariadb_server import ACCOUNTS, MariaDb

PASSWORDS = {account: f"{account}-password-1" for account in ACCOUNTS}


@pytest.fixture
def engine() -> Iterator[docker.DockerClient]:
    """The Docker engine."""
    with mariadb_server.engine() as client:
        yield client


@pytest.fixture
def volume(engine: docker.DockerClient) -> Iterator[str]:
    """A named volume, removed at the end."""
    made = engine.volumes.create()
    yield made.name
    made.remove(force=True)


def say(container: Container, account: str, sql: str) -> tuple[int, str]:
    """Run SQL as an account, over TCP as the other services do."""
    command = ["mariadb", "-h127.0.0.1", f"-u{account}", "--batch", "robotether", "-e", sql]
    done = run_inside(container, *command, environment={"MYSQL_PWD": PASSWORDS[account]})
    return done.returncode, done.stdout + done.stderr


def wait_exit(container: Container) -> str:
    assert container.wait(timeout=30)["StatusCode"] == 1
    return container.logs().decode()


@pytest.mark.parametrize(
    ("variable", "value"),
    [
        ("character_set_server", "utf8mb4"),
        ("log_bin", "OFF"),
        ("skip_name_resolve", "ON"),
        ("innodb_flush_log_at_trx_commit", "1"),
        ("tx_isolation", "READ-COMMITTED"),
        ("time_zone", "+00:00"),
        ("max_connections", "300"),
        ("local_infile", "OFF"),
    ],
)
def test_server_runs_with_our_configuration(mariadb: MariaDb, variable: str, value: str) -> None:
    """Asked of the server, not of the file."""
    assert (
        mariadb.as_root(f"SHOW GLOBAL VARIABLES LIKE '{variable}'").split("\t")[1].strip() == value
    )


def test_server_is_strict(mariadb: MariaDb) -> None:
    """A value that does not fit is an error, never cut."""
    assert "STRICT_ALL_TABLES" in mariadb.as_root("SELECT @@GLOBAL.sql_mode")


def test_records_outlive_the_container_and_secrets_may_change(
    engine: docker.DockerClient, volume: str, tmp_path: Path
) -> None:
    """A new container on the old volume has the rows, and the passwords of the secrets of now."""
    mariadb_server.write_secrets(tmp_path, PASSWORDS)
    first = mariadb_server.start(engine, tmp_path, volume)
    try:
        mariadb_server.wait_healthy(first)
        assert say(first, "migrate", "CREATE TABLE kept (x INT)") == (0, "")
        first.stop(timeout=20)
    finally:
        first.remove(force=True)
    mariadb_server.write_secrets(tmp_path, PASSWORDS | {"migrate": "another-password-2"})
    second = mariadb_server.start(engine, tmp_path, volume)
    try:
        mariadb_server.wait_healthy(second)
        assert "Access denied" in say(second, "migrate", "SELECT 1")[1]
        assert second.exec_run(["mariadb", "robotether", "-e", "SELECT * FROM kept"])[0] == 0
    finally:
        second.remove(force=True)


def test_interrupted_first_start_is_done_again(
    engine: docker.DockerClient, volume: str, tmp_path: Path
) -> None:
    """A container killed while it made its data directory leaves nothing that stops the next."""
    mariadb_server.write_secrets(tmp_path, PASSWORDS)
    killed = mariadb_server.start(engine, tmp_path, volume)
    try:
        end = time.monotonic() + 20
        while killed.exec_run(["test", "-e", "/var/lib/mysql/.being_made"])[0] != 0:
            assert time.monotonic() < end, killed.logs().decode()
        killed.kill()
    finally:
        killed.remove(force=True)
    second = mariadb_server.start(engine, tmp_path, volume)
    try:
        mariadb_server.wait_healthy(second)
        assert b"interrupted" in second.logs()
    finally:
        second.remove(force=True)


@pytest.mark.parametrize(
    ("password", "why"),
    [("it's-a-password", "only letters"), ("short", "at least 12"), ("", "at least 12")],
)
def test_password_that_cannot_be_used_stops_the_start(
    engine: docker.DockerClient, tmp_path: Path, password: str, why: str
) -> None:
    """The log names the account and what is allowed, and not the password."""
    mariadb_server.write_secrets(tmp_path, PASSWORDS | {"relay": password})
    container = mariadb_server.start(engine, tmp_path)
    try:
        log = wait_exit(container)
    finally:
        container.remove(force=True, v=True)
    assert "account relay" in log
    assert why in log
    assert not password or password not in log


def test_missing_secret_stops_the_start(engine: docker.DockerClient, tmp_path: Path) -> None:
    """The log names the file."""
    mariadb_server.write_secrets(tmp_path, PASSWORDS)
    (tmp_path / "mysql_web_password").unlink()
    container = mariadb_server.start(engine, tmp_path)
    try:
        assert "mysql_web_password is missing" in wait_exit(container)
    finally:
        container.remove(force=True, v=True)
