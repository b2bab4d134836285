"""The mysql image: what its entrypoint does with secrets and volumes, and what the server says is in force."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import docker
import mariadb_server
import pytest
from docker.models.containers import Container
from inside import run_inside
from mariadb_server import ACCOUNTS, ROOT, MariaDb

# A machine without the older Debian makes it first, and an image on it.
MAY_MAKE_A_BASE = pytest.mark.timeout(900)
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


IN_FORCE = {
    "character_set_server": "utf8mb4",
    "log_bin": "OFF",
    "skip_name_resolve": "ON",
    "innodb_flush_log_at_trx_commit": "1",
    "tx_isolation": "READ-COMMITTED",
    "time_zone": "+00:00",
    "max_connections": "300",
    "local_infile": "OFF",
}


def test_server_runs_with_our_configuration(mariadb: MariaDb) -> None:
    """Asked of the server, not of the file; a value that does not fit is an error, never cut."""
    lines = mariadb.as_root("SHOW GLOBAL VARIABLES").splitlines()
    found = dict(line.split("\t") for line in lines)
    assert {name: found[name] for name in IN_FORCE} == IN_FORCE
    assert "STRICT_ALL_TABLES" in found["sql_mode"]


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


@pytest.fixture(scope="module")
def older_suite() -> str:
    """A Debian whose MariaDB is of an older series, 10.11."""
    command = [ROOT / "tools" / "ensure_base_image", "bookworm"]
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    return "bookworm"


@pytest.fixture
def older_data(
    engine: docker.DockerClient, volume: str, tmp_path: Path, older_suite: str
) -> tuple[str, str]:
    """A volume with the data of the older server, and that server's series."""
    mariadb_server.write_secrets(tmp_path, PASSWORDS)
    older = mariadb_server.start(engine, tmp_path, volume, suite=older_suite)
    try:
        mariadb_server.wait_healthy(older)
        assert say(older, "migrate", "CREATE TABLE kept (x INT); INSERT INTO kept VALUES (7)") == (
            0,
            "",
        )
        series = ".".join(inside(older, "SELECT VERSION()").split(".")[:2])
        older.stop(timeout=30)
    finally:
        older.remove(force=True)
    return volume, series


def inside(container: Container, sql: str) -> str:
    """Ask as root, on the socket."""
    done = run_inside(
        container, "mariadb", "--batch", "--skip-column-names", "-e", sql, user="root"
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def needs_upgrade(container: Container) -> bool:
    """What MariaDB's own program says of the data."""
    command = ("mariadb-upgrade", "--user=mysql", "--check-if-upgrade-is-needed")
    done = run_inside(container, *command)
    assert not done.stderr
    return done.returncode == 0


@MAY_MAKE_A_BASE
@pytest.mark.release
def test_data_of_an_older_series_is_upgraded(
    engine: docker.DockerClient, older_data: tuple[str, str], tmp_path: Path
) -> None:
    """The newer server brings it up to date before it listens, once, and keeps the system tables of before."""
    volume, series = older_data
    container = mariadb_server.start(engine, tmp_path, volume)
    try:
        mariadb_server.wait_healthy(container)
        assert not inside(container, "SELECT VERSION()").startswith(f"{series}.")
        assert not needs_upgrade(container)
        assert say(container, "migrate", "SELECT x FROM kept") == (0, "x\n7\n")
        backup = f"/var/lib/mysql/system_tables_{series}.sql"
        assert run_inside(container, "stat", "--format=%a", backup).stdout.strip() == "600"
        assert "'keylookup'" in run_inside(container, "cat", backup).stdout
        container.restart(timeout=30)
        mariadb_server.wait_healthy(container)
        assert container.logs().decode().count("mysql: upgrading the data") == 1
    finally:
        container.remove(force=True)


@MAY_MAKE_A_BASE
@pytest.mark.release
def test_interrupted_upgrade_is_done_again_and_keeps_its_backup(
    engine: docker.DockerClient, older_data: tuple[str, str], tmp_path: Path
) -> None:
    """A server killed in the middle of its upgrade is upgraded at the next start, with the first backup kept."""
    volume, series = older_data
    backup = f"/var/lib/mysql/system_tables_{series}.sql"
    killed = mariadb_server.start(engine, tmp_path, volume)
    try:
        end = time.monotonic() + 60
        while killed.exec_run(["test", "-e", backup])[0] != 0:
            assert time.monotonic() < end, killed.logs().decode()
        first_backup = run_inside(killed, "sha256sum", backup).stdout
        killed.kill()
        assert b"upgraded the data" not in killed.logs()
    finally:
        killed.remove(force=True)
    second = mariadb_server.start(engine, tmp_path, volume)
    try:
        mariadb_server.wait_healthy(second)
        assert not needs_upgrade(second)
        assert run_inside(second, "sha256sum", backup).stdout == first_backup != ""
        assert say(second, "migrate", "SELECT x FROM kept") == (0, "x\n7\n")
    finally:
        second.remove(force=True)


@MAY_MAKE_A_BASE
@pytest.mark.release
def test_data_of_a_newer_series_is_refused(
    engine: docker.DockerClient, older_data: tuple[str, str], older_suite: str, tmp_path: Path
) -> None:
    """MariaDB does not go back: the older server leaves the data alone and says what to do."""
    volume, series = older_data
    newer = mariadb_server.start(engine, tmp_path, volume)
    try:
        mariadb_server.wait_healthy(newer)
        newer.stop(timeout=30)
    finally:
        newer.remove(force=True)
    older = mariadb_server.start(engine, tmp_path, volume, suite=older_suite)
    try:
        assert f"this image has {series}" in wait_exit(older)
    finally:
        older.remove(force=True)


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
    ("password", "says"),
    [
        ("it's-a-password", ("account relay", "only letters")),
        ("short", ("account relay", "at least 12")),
        (None, ("mysql_relay_password is missing",)),
    ],
)
def test_password_that_cannot_be_used_stops_the_start(
    engine: docker.DockerClient, tmp_path: Path, password: str | None, says: tuple[str, ...]
) -> None:
    """The log names the account and what is allowed, or the file, and not the password."""
    mariadb_server.write_secrets(tmp_path, PASSWORDS | {"relay": password or ""})
    if password is None:
        (tmp_path / "mysql_relay_password").unlink()
    container = mariadb_server.start(engine, tmp_path)
    try:
        log = wait_exit(container)
    finally:
        container.remove(force=True, v=True)
    assert all(words in log for words in says)
    assert not password or password not in log
