"""The mysql image: what its entrypoint does with secrets and volumes, and what the server says is in force."""

import os

import mariadb_server
import pytest
from commands import output_of_command, run_command
from inside import run_inside
from mariadb_server import ACCOUNTS, ROOT
from openssh_server import wait_until

# A machine without the older Debian makes it first, and an image on it.
MAY_MAKE_A_BASE = pytest.mark.timeout(900)
PASSWORDS = {account: f"{account}-password-1" for account in ACCOUNTS}


@pytest.fixture
def start(tmp_path):
    """Starts servers with their secrets in a folder, on one volume; all are removed at the end."""
    started = []
    mariadb_server.write_secrets(tmp_path, PASSWORDS)
    with mariadb_server.engine() as engine:
        volume = engine.volumes.create()

        def start_server(*, is_healthy=True, **options):
            container = mariadb_server.start(engine, tmp_path, volume.name, **options)
            started.append(container)
            if is_healthy:
                mariadb_server.wait_healthy(container)
            return container

        yield start_server
        for container in started:
            container.remove(force=True)
        volume.remove(force=True)


def wait_for_file(container, path):
    wait_until(
        lambda: container.exec_run(["test", "-e", path])[0] == 0,
        lambda: container.logs().decode(),
        60,
    )


def say(container, account, sql):
    """Run SQL as an account, over TCP as the other services do."""
    command = ["mariadb", "-h127.0.0.1", f"-u{account}", "--batch", "robotether", "-e", sql]
    done = run_inside(container, *command, environment={"MYSQL_PWD": PASSWORDS[account]})
    return done.returncode, done.stdout + done.stderr


def wait_exit(container):
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


def test_server_runs_with_our_configuration(mariadb):
    """The server itself is asked, not the file; a value that does not fit is an error, never cut."""
    lines = mariadb.as_root("SHOW GLOBAL VARIABLES").splitlines()
    found = dict(line.split("\t") for line in lines)
    assert {name: found[name] for name in IN_FORCE} == IN_FORCE
    assert "STRICT_ALL_TABLES" in found["sql_mode"]


def test_records_outlive_the_container_and_secrets_may_change(start, tmp_path):
    """A new container on the old volume has the rows, and the passwords of the secrets of now."""
    first = start()
    assert say(first, "migrate", "CREATE TABLE kept (x INT)") == (0, "")
    first.stop(timeout=20)
    mariadb_server.write_secrets(tmp_path, PASSWORDS | {"migrate": "another-password-2"})
    second = start()
    assert "Access denied" in say(second, "migrate", "SELECT 1")[1]
    assert inside(second, "SELECT * FROM kept") == ""


@pytest.fixture(scope="module")
def older_suite():
    """A Debian whose MariaDB is of an older series, 10.11."""
    output_of_command(ROOT / "tools" / "ensure_base_image", "bookworm", limit_s=600)
    return "bookworm"


@pytest.fixture
def older_series(start, older_suite):
    """The series of an older server, which has left its data on the volume."""
    older = start(suite=older_suite)
    made = say(older, "migrate", "CREATE TABLE kept (x INT); INSERT INTO kept VALUES (7)")
    assert made == (0, "")
    series = ".".join(inside(older, "SELECT VERSION()").split(".")[:2])
    older.stop(timeout=30)
    return series


def inside(container, sql):
    """Ask as root, on the socket."""
    command = ("mariadb", "--batch", "--skip-column-names", "robotether", "-e", sql)
    done = run_inside(container, *command, user="root")
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def needs_upgrade(container):
    """What MariaDB's own program says of the data."""
    command = ("mariadb-upgrade", "--user=mysql", "--check-if-upgrade-is-needed")
    done = run_inside(container, *command)
    assert not done.stderr
    return done.returncode == 0


@MAY_MAKE_A_BASE
@pytest.mark.release
def test_data_of_an_older_series_is_upgraded(start, older_series):
    """The newer server brings it up to date before it listens, once, and keeps the system tables of before."""
    container = start()
    assert not inside(container, "SELECT VERSION()").startswith(f"{older_series}.")
    assert not needs_upgrade(container)
    assert say(container, "migrate", "SELECT x FROM kept") == (0, "x\n7\n")
    backup = f"/var/lib/mysql/system_tables_{older_series}.sql"
    assert run_inside(container, "stat", "--format=%a", backup).stdout.strip() == "600"
    assert "'keylookup'" in run_inside(container, "cat", backup).stdout
    container.restart(timeout=30)
    mariadb_server.wait_healthy(container)
    assert container.logs().decode().count("mysql: upgrading the data") == 1


@MAY_MAKE_A_BASE
@pytest.mark.release
def test_interrupted_upgrade_is_done_again_and_keeps_its_backup(start, older_series):
    """A server killed in the middle of its upgrade is upgraded at the next start, with the first backup kept."""
    backup = f"/var/lib/mysql/system_tables_{older_series}.sql"
    killed = start(is_healthy=False)
    wait_for_file(killed, backup)
    first_backup = run_inside(killed, "sha256sum", backup).stdout
    killed.kill()
    assert b"upgraded the data" not in killed.logs()
    second = start()
    assert not needs_upgrade(second)
    assert run_inside(second, "sha256sum", backup).stdout == first_backup != ""
    assert say(second, "migrate", "SELECT x FROM kept") == (0, "x\n7\n")


@MAY_MAKE_A_BASE
@pytest.mark.release
def test_data_of_a_newer_series_is_refused(start, older_series, older_suite):
    """MariaDB does not go back: the older server leaves the data alone and says what to do."""
    start().stop(timeout=30)
    older = start(is_healthy=False, suite=older_suite)
    assert f"this image has {older_series}" in wait_exit(older)


def test_interrupted_first_start_is_done_again(start):
    """A container killed while it made its data directory leaves nothing that stops the next."""
    killed = start(is_healthy=False)
    wait_for_file(killed, "/var/lib/mysql/.being_made")
    killed.kill()
    assert b"interrupted" in start().logs()


@pytest.mark.parametrize(
    ("password", "says"),
    [
        ("it's-a-password", ("account relay", "only letters")),
        ("short", ("account relay", "at least 12")),
        (None, ("mysql_relay_password is missing",)),
    ],
)
def test_password_that_cannot_be_used_stops_the_start(start, tmp_path, password, says):
    """The log names the account and what is allowed, or the file, and not the password."""
    mariadb_server.write_secrets(tmp_path, PASSWORDS | {"relay": password or ""})
    if password is None:
        (tmp_path / "mysql_relay_password").unlink()
    log = wait_exit(start(is_healthy=False))
    assert all(words in log for words in says)
    assert not password or password not in log


@pytest.mark.parametrize(
    ("name", "value"), [("DB_READ_ONLY", "off"), ("DB_READ_ONLY", "0"), ("DB_PARTNER", "192.0.2.7")]
)
def test_partner_is_asked_however_its_settings_are_written(tmp_path, name, value):
    """Else an old database would start beside the one that was promoted."""
    script = (mariadb_server.IMAGE_DIR / "entrypoint").read_text()
    script = script.replace("data=/var/lib/mysql", f"data={tmp_path}")
    environ = {**os.environ, "DB_PARTNER": "192.0.2.7:3306", name: value}
    done = run_command("sh", "-c", script, env=environ)
    assert done.returncode == 1
    assert f"cannot start: {name} is '{value}'; allowed is" in done.stderr
