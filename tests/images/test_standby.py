"""A standby of the database: the commands of docs/howto/standby.md, on its two machines and one more that is a cell."""

import json
import os
import re
import ssl
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from functools import cached_property

import pymysql
import pytest
from cells import first_cell, second_cell
from commands import path_with, write_programs
from image_names import ensure_built
from stack import ROOT

pytestmark = pytest.mark.release
PAGE = ROOT / "docs" / "howto" / "standby.md"
# What the page runs on another machine runs in this checkout, with that machine's settings.
SSH = """#!/bin/sh
[ "$1" = -- ] && shift
export ENV_FILE="$(cat "$SITE/$1.env_file")"
shift
exec sh -c "cd() { [ \\$1 = robotether ]; }; $*"
"""
# The images are built.
MAKE = """#!/bin/sh
[ "$*" = up ] && exec tools/up --no-build
"""
SERVICES = ("mysql", "nginx", "web", "relay", "sshd")


def blocks(heading):
    section = PAGE.read_text().split(f"\n## {heading}\n")[1].split("\n## ")[0]
    return re.findall(r"^```sh\n(.*?)^```$", section, re.MULTILINE | re.DOTALL)


class Site:
    """Machine a with the database, b with its standby, and the cell c."""

    def __init__(self, folder, first):
        self._folder = folder
        self.a = first
        self.b = first_cell(folder / "b", "b")
        programs = folder / "programs"
        write_programs(programs, {"ssh": SSH, "make": MAKE})
        for machine in (self.a, self.b):
            name = f"{machine.settings['CELL']}.robots.example.com"
            (folder / f"{name}.env_file").write_text(os.path.relpath(machine.env_file, ROOT))
            machine.variables |= {**path_with(programs), "SITE": str(folder)}

    def _here(self, text):
        """What the page says, with the addresses of this test's machines, which differ in their ports."""
        for number, machine in ((1, self.a), (2, self.b)):
            address, own = f"192.0.2.{number}", machine.settings
            text = text.replace(f"{address}:3306", str(own["DB_PUBLISH"]))
            text = text.replace(f"{address}:8444", str(own["PEER_ADDRESS"]))
            text = text.replace(address, str(self.c.settings["DB_HOST"]))
        return text

    def set(self, machine, block):
        machine.settings |= dict(line.split("=", 1) for line in self._here(block).splitlines())
        machine.write_settings()

    def run(self, machine, block):
        """Run a block on a machine. Its images are built."""
        lines = [line for line in block.splitlines() if not line.startswith("tools/build ")]
        script = "set -e\n" + "\n".join(lines).replace("compose exec", "compose exec -T")
        return machine.tool("bash", "-c", script, timeout=400)

    @cached_property
    def secrets(self):
        folder = self._folder / "b" / "secrets"
        self.a.tool("tools/site_secrets", str(folder))
        return folder

    @contextmanager
    def connection(self, machine):
        """A cursor at a machine's database, reached as by other machines."""
        host, port = str(machine.settings["DB_PUBLISH"]).split(":")
        connection = pymysql.connect(
            host=host, port=int(port), user="migrate", database="robotether", autocommit=True,
            password=(self.secrets / "mysql_migrate_password").read_text().strip(),
            ssl=ssl.create_default_context(cafile=self.secrets / "database_ca.pem"),
        )  # fmt: skip
        try:
            yield connection.cursor()
        finally:
            connection.close()


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """All three; the standby follows."""
    ensure_built("default")
    folder = tmp_path_factory.mktemp("site")
    made = Site(folder, first_cell(folder))
    made.a.is_built = True
    with ExitStack() as stack:
        stack.callback(made.a.down)
        made.a.up(robots=False)
        made.c = stack.enter_context(second_cell(made.a, "c"))
        on_a, make_up, on_b, follow = blocks("Set it up")
        made.set(made.a, on_a)
        made.run(made.a, make_up)
        assert made.secrets.is_dir()
        stack.callback(made.b.down)
        made.set(made.b, on_b)
        made.run(made.b, follow)
        yield made


def semi_sync(site, machine):
    printed = site.run(machine, blocks("See that it works")[0])
    return dict(line.split("\t") for line in printed.splitlines()[1:])


def replica(site, machine):
    printed = site.run(machine, blocks("See that it works")[1])
    return dict(re.findall(r"^ *(\w+): (.*)$", printed, re.MULTILINE))


def wait_for_sync(site, machine, status):
    machine.wait(
        f"semi-sync {status}",
        lambda: semi_sync(site, machine)["Rpl_semi_sync_master_status"] == status,
        "mysql",
        seconds=60,
    )


def test_standby_is_waited_for(site):
    """It follows over TLS, with a right to read alone, and takes records of nobody else."""
    shown = semi_sync(site, site.a)
    assert shown["Rpl_semi_sync_master_status"] == "ON"
    assert shown["Rpl_semi_sync_master_clients"] == "1"
    replicated = replica(site, site.b)
    assert replicated["Slave_IO_Running"] == replicated["Slave_SQL_Running"] == "Yes"
    assert replicated["Master_SSL_Allowed"] == "Yes"
    [[right]] = site.a.sql("SHOW GRANTS FOR replication@'%'")
    assert right.startswith("GRANT REPLICATION SLAVE ON *.* TO `replication`@`%` IDENTIFIED BY")
    assert right.endswith("REQUIRE SSL")
    with site.connection(site.b) as cursor, pytest.raises(pymysql.Error, match="read-only"):
        cursor.execute("CREATE TABLE numbers (number INT PRIMARY KEY)")


def test_site_goes_on_without_its_standby(site):
    """Records are confirmed alone, which shows, until the standby has them all."""
    standby = site.b.container("mysql")
    with site.connection(site.a) as cursor:
        cursor.execute("CREATE TABLE numbers (number INT PRIMARY KEY) ENGINE=InnoDB")
        standby.pause()
        try:
            cursor.execute("INSERT INTO numbers VALUES (0)")
        finally:
            standby.unpause()
    assert int(semi_sync(site, site.a)["Rpl_semi_sync_master_no_tx"]) > 0
    wait_for_sync(site, site.a, "ON")


class Numbers(threading.Thread):
    """Writes rows 1, 2, 3, ... until the database is gone; `confirmed` is the last that it confirmed."""

    def __init__(self, site, machine):
        super().__init__()
        self._connection = site.connection(machine)
        self.confirmed = 0

    def run(self):
        with self._connection as cursor:
            try:
                while True:
                    cursor.execute("INSERT INTO numbers VALUES (%s)", (self.confirmed + 1,))
                    self.confirmed += 1
            except pymysql.err.OperationalError:
                return


def numbers_at(site, machine):
    with site.connection(machine) as cursor:
        cursor.execute("SELECT number FROM numbers ORDER BY number")
        return [int(number) for (number,) in cursor.fetchall()]


def alive(cell):
    """The cells that one sees, as the site's database and the relays have them."""
    listed = json.loads(cell.robotether("cell", "list", "--json"))
    return {row["name"] for row in listed if row["is_alive"]}


def test_promoted_standby_has_all_that_was_confirmed(site):
    site.c.robotether("user", "add", "ann")
    numbers = Numbers(site, site.a)
    # However busy the machine of the test is, nothing is confirmed without the standby.
    site.a.sql("SET GLOBAL rpl_semi_sync_master_timeout = 60000")
    wait_for_sync(site, site.a, "ON")
    with site.connection(site.b) as reader:
        reader.execute("LOCK TABLES numbers READ")
        before = semi_sync(site, site.a)["Rpl_semi_sync_master_no_tx"]
        numbers.start()
        site.a.wait("records", lambda: numbers.confirmed >= 200, "mysql")
        assert semi_sync(site, site.a)["Rpl_semi_sync_master_no_tx"] == before
        for service in SERVICES:
            site.a.container(service).kill()
        numbers.join(timeout=30)
        reader.execute("SELECT COUNT(*) FROM numbers")
        assert reader.fetchall() == ((1,),)
        _, off, promote, on_cells = blocks("Promote the standby")
        site.set(site.b, off)
        with ThreadPoolExecutor(1) as pool:
            promoted = pool.submit(site.run, site.b, promote)
            try:
                site.b.wait(
                    "the end of receiving",
                    lambda: replica(site, site.b).get("Slave_IO_Running") == "No",
                    "mysql",
                )
            finally:
                reader.execute("UNLOCK TABLES")
            promoted.result()
    assert numbers_at(site, site.b)[: numbers.confirmed + 1] == list(range(numbers.confirmed + 1))
    site.set(site.c, on_cells)
    # The machines of the test have one address.
    site.set(site.c, f"DB_PORT={site.b.settings['DB_PORT']}")
    site.c.tool("tools/up", "--no-build", timeout=400)
    for cell in (site.b, site.c):
        assert "ann" in cell.robotether("user", "list")
        cell.wait("b and c alive", lambda cell=cell: alive(cell) == {"b", "c"}, "relay", seconds=60)
    site.c.robotether("user", "add", "ben")
    assert "ben" in site.b.robotether("user", "list")


def test_promoted_database_has_what_migrations_need(site):
    [[state]] = site.b.sql(
        "SELECT status FROM information_schema.events WHERE event_name = 'prune_history'"
    )
    assert state == "ENABLED"
    assert site.b.sql("SELECT @@event_scheduler, @@read_only") == [["ON", "0"]]
    with site.connection(site.b) as first, site.connection(site.b) as second:
        first.execute("SELECT GET_LOCK('taken', 0)")
        second.execute("SELECT GET_LOCK('taken', 0)")
        assert (first.fetchall(), second.fetchall()) == (((1,),), ((0,),))


def test_old_database_comes_back_as_standby_alone(site):
    """With its old data it does not start; as the page says it follows the one that was promoted."""
    old = site.a.container("mysql")
    old.start()
    site.a.wait("refused", lambda: b"was promoted, and this one is old" in old.logs(), "mysql")
    down, on, follow = blocks("Bring the old machine back")
    site.run(site.a, down)
    site.set(site.a, on)
    site.run(site.a, follow)
    wait_for_sync(site, site.b, "ON")
    with site.connection(site.b) as cursor:
        cursor.execute("INSERT INTO numbers VALUES (1000000)")
    site.a.wait("the new row", lambda: numbers_at(site, site.a)[-1] == 1000000, "mysql")
    [[state]] = site.a.sql(
        "SELECT status FROM information_schema.events WHERE event_name = 'prune_history'"
    )
    assert state in {"SLAVESIDE_DISABLED", "REPLICA_SIDE_DISABLED"}
