"""tools/backup with a real database and its trial, else with programs in the place of Docker; so tools/restore."""

import gzip
import os
import tarfile
import time
from pathlib import Path

import pytest
from commands import copy_tools, path_with, run_command, write_programs
from robotether_server.db import Database, robots, routes, users
from robotether_server.db.routes import NewRoute
from robotether_server.disks import recorded_space
from robotether_server.problems import StoreUnavailableError

# What runs in the service backup runs here.
COMPOSE = """#!/bin/bash
case "$*" in
  '--env BACKUP_COPY_COMMAND') cat copy_command ;;
  config\\ --services) cat services ;;
  config) echo 'name: lab' ;;
  ps*) cat container ;;
  start*) exit 1 ;;
  *mariadb-dump*) if [ -e dump ]; then cat dump; else docker exec "$(cat container)" "${@:4}"; fi ;;
  exec*) docker exec --interactive "$(cat container)" "${@:4}" ;;
  *' backup '*)
    while [ "$1" != backup ]; do shift; done
    shift
    set -- "${@//\\/backup/$PWD/volumes}"
    "${@//\\/record/$PWD/record}"
    ;;
esac
"""
# The database has what the file `here` says, and its restored copy what `there` says.
DOCKER = """#!/bin/sh
case "$*" in
  exec*CONCAT_WS*) cat here ;;
  inspect*) echo image ;;
  run*) cat >/dev/null; cat there ;;
  volume*) cat volumes_of_lab ;;
esac
"""
SECRETS = (
    "secrets/web/ticket_key",
    "secrets/web/web_secret_key",
    "secrets/relay/session_key",
    "secrets/relay/peer_key.pem",
    "ssh_host_keys/ssh_host_ed25519_key",
    *(
        f"secrets/mysql/mysql_{name}_password"
        for name in ("web", "relay", "recorder", "keylookup", "migrate")
    ),
    "secrets/web/admin_password",
    "own/ticket_key",
    "own/.gitignore",
)
# It breaks off in the midst.
SQL_OF_THEN = b"SELECT 1; of then\n"
NOT_KEPT = {"secrets/web/admin_password", "own/.gitignore"}


@pytest.fixture
def checkout(tmp_path):
    """A checkout with the tools, settings, secrets and a database."""
    folder = tmp_path / "checkout"
    copy_tools(folder, "backup", "restore")
    write_programs(folder / "tools", {"compose": COMPOSE})
    write_programs(folder / "programs", {"docker": DOCKER})
    files = {"services": "mysql\nweb\n", "container": "0123456789ab\n", "copy_command": ""}
    files |= {"here": "19 migrations\n", "there": "19 migrations\n", "volumes_of_lab": ""}
    for name, text in files.items():
        (folder / name).write_text(text)
    (folder / "record").mkdir()
    (folder / "compose").mkdir()
    (folder / "compose" / ".env").write_text("PUBLIC_HOST=robots.test\n")
    for name in SECRETS:
        file = folder / "volumes" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("long-enough-for-a-password")
    return folder


@pytest.fixture
def real(checkout, mariadb):
    """With a real database and the real Docker."""
    (checkout / "programs" / "docker").unlink()
    (checkout / "container").write_text(f"{mariadb.container.id}\n")
    return checkout


def run(checkout, tool, *arguments, status=0):
    """Run a tool there, from the folder above."""
    environ = path_with(checkout / "programs")
    done = run_command(checkout / "tools" / tool, *arguments, cwd=checkout.parent, env=environ)
    assert done.returncode == status, done.stderr
    return done


def names(folder):
    return {path.name for path in folder.iterdir()}


def recorded(checkout):
    """What web and relay read: times as seconds since 1970, and the folder's disk."""
    files = {path.name: path for path in (checkout / "record").iterdir()}
    disk = recorded_space(files.pop("disk")) if "disk" in files else None
    assert disk is None or (0 < disk.free < disk.size and ":" in disk.device)
    return {name: int(path.read_text()) for name, path in files.items()}


def test_backup_has_all_for_its_owner_alone_and_old_ones_go(real):
    """It has database, secrets and settings; a relative folder begins where the tool is called; other files stay."""
    folder = real.parent / "backups"
    folder.mkdir()
    # Those of 2999 were made before the clock was set back, and two are of one day.
    of_a_day = {"robotether-20200102T000000Z.tar", "robotether-20200102T120000Z.tar"}
    for name in ("20200101", "29990101", "29990102"):
        (folder / f"robotether-{name}T000000Z.tar").write_text("")
    for name in of_a_day:
        (folder / name).write_text("")
    (folder / "notes.txt").write_text("")
    begun = int(time.time())
    done = run(real, "backup", "backups", "2")
    newest = Path(done.stdout.split()[-1])
    assert newest.stat().st_mode & 0o777 == 0o600
    assert names(folder) == {*of_a_day, newest.name, "notes.txt"}
    assert begun <= recorded(real)["made"] <= time.time()
    assert recorded(real).keys() == {"made"}
    assert "disk" in names(real / "record")
    with tarfile.open(newest) as parts:
        assert parts.extractfile("./env").read() == b"PUBLIC_HOST=robots.test\n"
        with tarfile.open(fileobj=parts.extractfile("./volumes.tar")) as volumes:
            files = {volume.name.removeprefix("./") for volume in volumes if volume.isfile()}
    assert files == set(SECRETS) - NOT_KEPT


def test_database_that_does_not_come_back_is_no_backup(real):
    """What the trial says is shown; old backups stay, and nothing is recorded."""
    (real / "dump").write_text("CREATE TABLE robotether.half (")
    old = real.parent / "backups" / "robotether-20200101T000000Z.tar"
    # A run of the day before was killed.
    (old.parent / ".robotether-killed").mkdir(parents=True)
    two_days_ago = time.time() - 2 * 86_400
    os.utime(old.parent / ".robotether-killed", (two_days_ago, two_days_ago))
    old.write_text("")
    done = run(real, "backup", "backups", "1", status=1)
    assert "You have an error in your SQL syntax" in done.stderr
    assert "the backup cannot be restored, see above" in done.stderr
    assert names(old.parent) == {old.name}
    assert recorded(real) == {}


def test_database_that_comes_back_in_part_is_no_backup(checkout):
    (checkout / "there").write_text("18 migrations\n")
    done = run(checkout, "backup", "backups", status=1)
    assert "of 19 migrations only 18 migrations were restored" in done.stderr
    assert names(checkout.parent / "backups") == set()


@pytest.mark.parametrize("missing", ["secrets/web/ticket_key", ""])
def test_backup_without_its_secrets_is_none(real, missing):
    (real / "volumes" / missing).rename(real / "moved")
    done = run(real, "backup", "backups", status=1)
    said = f"it lacks the secret {missing}" if missing else "cannot back up to"
    assert said in done.stderr
    assert names(real.parent / "backups") == set()
    assert recorded(real) == {}


def test_copy_gets_the_path_and_is_recorded_once_it_succeeded(checkout):
    """A copy that fails leaves the backup, which counts, and ends with an error."""
    elsewhere = checkout.parent / "else where"
    elsewhere.mkdir()
    (checkout / "copy_command").write_text("echo no route to it >&2; exit 3;")
    failed = run(checkout, "backup", "backups", status=1)
    assert "no route to it\n" in failed.stderr
    assert "BACKUP_COPY_COMMAND ended with 3, see above. The backup itself is good" in failed.stderr
    assert recorded(checkout).keys() == {"made"}
    (checkout / "copy_command").write_text(f"cp --target-directory '{elsewhere}'")
    run(checkout, "backup", "backups")
    [copied] = elsewhere.iterdir()
    assert copied.read_bytes() == (checkout.parent / "backups" / copied.name).read_bytes()
    assert recorded(checkout).keys() == {"made", "copied"}


@pytest.fixture
def backup_file(tmp_path):
    """What looks like a backup, of another machine's settings."""
    parts = tmp_path / "parts"
    parts.mkdir()
    (parts / "database.sql.gz").write_bytes(gzip.compress(SQL_OF_THEN))
    (parts / "env").write_text("of then\n")
    with tarfile.open(parts / "volumes.tar", "w") as volumes:
        volumes.add(parts / "env", "env")
    with tarfile.open(tmp_path / "robotether.tar", "w") as file:
        file.add(parts, ".")
    return tmp_path / "robotether.tar"


@pytest.mark.parametrize(
    ("volumes", "says"),
    [
        ("lab_mysql\n", "the stack lab has data on this machine"),
        (None, "nobody knows whether this machine has data of the stack"),
    ],
)
def test_restore_touches_no_stack_that_may_have_data(checkout, backup_file, volumes, says):
    """It leaves its settings, too, and names what removes the data, or replaces the records alone."""
    (checkout / "compose" / ".env").unlink()
    if volumes:
        (checkout / "volumes_of_lab").write_text(volumes)
    else:
        # So docker fails.
        (checkout / "volumes_of_lab").unlink()
    done = run(checkout, "restore", str(backup_file), status=1)
    assert says in done.stderr
    assert not (checkout / "compose" / ".env").exists()


def test_other_files_are_no_backup(checkout, tmp_path):
    for content in (b"", b"-- MariaDB dump"):
        (tmp_path / "file").write_bytes(content)
        done = run(checkout, "restore", "--database", str(tmp_path / "file"), status=1)
        assert f"cannot restore {tmp_path}/file" in done.stderr


def test_a_restored_route_does_not_drive_its_robot_again(real, database):
    """It may have ended since the backup, by a stop."""
    with database.transaction() as tx:
        ends = [robots.add(tx, f"02:00:00:00:51:0{number}", f"sim{number}") for number in (1, 2)]
        user_id = users.add(tx, "ann", "x", "user")
        routes.add(tx, NewRoute(ends[0], "/cmd_vel", ends[1], "/cmd_vel", "a/msg/B", 20, user_id))
    backup = run(real, "backup", "backups").stdout.split()[-1]
    run(real, "restore", "--database", backup)
    assert [route.end_code for route in database.run(routes.list_all)] == ["records_restored"]


def test_half_a_restored_database_serves_nobody(real, mariadb, database, backup_file):
    """It makes no backup, and a start of the database, which sets the passwords anew, lets nobody in."""
    whole = Path(run(real, "backup", "backups").stdout.split()[-1])
    failed = run(real, "restore", "--database", str(backup_file), status=1)
    assert f"Run tools/restore --database {backup_file} again" in failed.stderr
    password = mariadb.passwords["web"]
    mariadb.as_root(f"ALTER USER web IDENTIFIED BY '{password}' WITH MAX_USER_CONNECTIONS 90")
    for account in ("web", "migrate"):
        with pytest.raises(StoreUnavailableError, match="restore has not finished"):
            Database(mariadb.settings(account)).run(lambda tx: tx.rows("SELECT 1"))
    assert "restore has not finished" in run(real, "backup", "backups", status=1).stderr
    # A standby has this of it.
    assert "robotether_restoring" in mariadb.as_root("SHOW DATABASES")
    run(real, "restore", "--database", str(whole))
    assert "robotether_restoring" not in mariadb.as_root("SHOW DATABASES")
    assert database.run(lambda tx: tx.rows("SELECT 1"))
    run(real, "backup", "backups")


@pytest.mark.parametrize(
    ("services", "is_damaged", "says"),
    [
        ("mysql\nweb\n", True, "it is damaged, see above. Nothing was changed"),
        ("web\n", False, "the database of this site is on another machine"),
    ],
)
def test_restore_that_cannot_succeed_stops_nothing(
    checkout, backup_file, services, is_damaged, says
):
    (checkout / "services").write_text(services)
    if is_damaged:
        content = bytearray(backup_file.read_bytes())
        at = content.index(gzip.compress(SQL_OF_THEN)[10:])
        content[at] ^= 0xFF
        backup_file.write_bytes(content)
    write_programs(
        checkout / "tools",
        {"compose": COMPOSE.replace("  ps*)", "  stop*) touch stopped ;;\n  ps*)")},
    )
    done = run(checkout, "restore", "--database", str(backup_file), status=1)
    assert says in done.stderr
    assert not (checkout / "stopped").exists()
