"""What each database account may do: as the server itself says, and as it shows when somebody tries."""

from __future__ import annotations

import re

import pymysql
import pytest
from mariadb_server import MariaDb
from pymysql.constants import ER
from robotether_server.db import Database

DENIED = {
    ER.TABLEACCESS_DENIED_ERROR,
    ER.COLUMNACCESS_DENIED_ERROR,
    ER.DBACCESS_DENIED_ERROR,
    ER.SPECIFIC_ACCESS_DENIED_ERROR,
    ER.PROCACCESS_DENIED_ERROR,
    ER.ACCESS_DENIED_ERROR,
}
EDIT = "SELECT, INSERT, UPDATE, DELETE"
# All that a relay writes of its cell, by name: who drains one is an admin.
CELL = (
    "clock_ahead_s, heartbeat_at, host, https_port, peer_address, region, robots, ssh_ports, "
    "started_at, version"
)
EXPECTED = {
    "web": {
        "users": EDIT,
        "robots": EDIT,
        "grants": EDIT,
        "api_tokens": EDIT,
        "logins": EDIT,
        "join_tokens": EDIT,
        "join_token_uses": "SELECT, INSERT",
        "key_claims": EDIT,
        "refused_joins": EDIT,
        "user_ssh_keys": EDIT,
        "sites": EDIT,
        "user_groups": EDIT,
        "user_group_members": EDIT,
        "relay_grants": "SELECT",
        "other_keys": "SELECT",
        "robot_sessions": "SELECT",
        "control_leases": "SELECT",
        "drives": "SELECT",
        "robot_stops": "SELECT",
        "audit_events": "SELECT, INSERT",
        "cells": "SELECT, UPDATE (draining)",
        "PROCEDURE remove_cell": "EXECUTE",
    },
    "relay": {
        "relay_robots": "SELECT",
        "relay_grants": "SELECT",
        "relay_logins": "SELECT",
        "relay_tokens": "SELECT",
        "relay_changes": "SELECT",
        "robot_sessions": "SELECT, INSERT, UPDATE",
        "control_leases": "SELECT, INSERT, UPDATE",
        "drives": "SELECT, INSERT, UPDATE",
        "robot_stops": EDIT,
        "audit_events": "INSERT",
        "cells": f"SELECT, INSERT ({CELL.replace('peer', 'name, peer')}), UPDATE ({CELL})",
    },
    "keylookup": {
        "tunnel_keys": "SELECT",
        "jump_keys": "SELECT",
        "PROCEDURE record_refused_key": "EXECUTE",
    },
}


def connect(mariadb: MariaDb, account: str) -> pymysql.Connection[pymysql.cursors.Cursor]:
    settings = mariadb.settings(account)
    return pymysql.connect(
        host=settings.host,
        port=settings.port,
        user=account,
        password=settings.password,
        database=settings.name,
    )


def grants_in_force(mariadb: MariaDb, account: str) -> dict[str, str]:
    """Rights by object; the line that only says that the account exists must give nothing."""
    with connect(mariadb, account) as connection, connection.cursor() as cursor:
        cursor.execute("SHOW GRANTS")
        lines = [row[0] for row in cursor.fetchall()]
    found = {}
    for line in lines:
        rights, place = re.fullmatch(r"GRANT (.*?) ON (.*?) TO .*", line).groups()
        if place == "*.*":
            assert rights == "USAGE"
        else:
            rights = re.sub(r"\(.*?\)", _in_order, rights.replace("`", ""))
            found[place.replace("`", "").replace("robotether.", "")] = rights
        assert "GRANT OPTION" not in line
    return found


def _in_order(columns: re.Match[str]) -> str:
    return f"({', '.join(sorted(columns[0].strip('()').split(', ')))})"


@pytest.mark.parametrize("account", ["web", "relay", "keylookup"])
def test_account_has_its_rights_and_no_other(mariadb: MariaDb, account: str) -> None:
    """SHOW GRANTS lists exactly what the design gives."""
    assert grants_in_force(mariadb, account) == EXPECTED[account]


def test_migrate_rules_its_database_and_nothing_global(mariadb: MariaDb) -> None:
    """All rights on robotether.*, with the right to pass them on, and no global one."""
    with connect(mariadb, "migrate") as connection, connection.cursor() as cursor:
        cursor.execute("SHOW GRANTS")
        lines = [row[0] for row in cursor.fetchall()]
    assert len(lines) == 2
    assert lines[0].startswith("GRANT USAGE ON *.* ")
    assert lines[1] == "GRANT ALL PRIVILEGES ON `robotether`.* TO `migrate`@`%` WITH GRANT OPTION"


@pytest.mark.parametrize(
    ("account", "statement"),
    [
        ("web", "INSERT INTO robot_sessions (robot_id, address) VALUES (1, '')"),
        ("web", "DELETE FROM audit_events"),
        ("web", "DELETE FROM robot_stops"),
        ("web", "UPDATE control_leases SET fence = 1"),
        ("relay", "DELETE FROM control_leases"),
        ("web", "UPDATE audit_events SET actor = 'x'"),
        ("web", "UPDATE cells SET host = 'x'"),
        ("web", "DELETE FROM cells"),
        ("relay", "UPDATE cells SET draining = FALSE"),
        ("relay", "CALL remove_cell('a')"),
        ("web", "SELECT * FROM port_pairs"),
        ("web", "DELETE FROM port_pairs"),
        ("web", "DELETE FROM shell_ports"),
        ("web", "DELETE FROM join_token_uses"),
        ("web", "DROP TABLE robots"),
        ("web", "CREATE TABLE x (y INT)"),
        ("web", "SELECT * FROM mysql.global_priv"),
        ("relay", "SELECT password_hash FROM users"),
        ("relay", "SELECT * FROM api_tokens"),
        ("relay", "SELECT * FROM logins"),
        ("relay", "SELECT * FROM robots"),
        ("relay", "UPDATE relay_robots SET state = 'active'"),
        ("relay", "DELETE FROM robot_sessions"),
        ("relay", "SELECT * FROM audit_events"),
        ("relay", "CALL record_refused_key('x', 'y')"),
        ("relay", "SELECT * FROM join_tokens"),
        ("keylookup", "SELECT * FROM user_ssh_keys"),
        ("keylookup", "UPDATE jump_keys SET shell_port = 1"),
        ("keylookup", "SELECT * FROM robots"),
        ("keylookup", "UPDATE tunnel_keys SET robot_id = 1"),
        ("keylookup", "INSERT INTO audit_events (actor, kind) VALUES ('a', 'b')"),
        ("keylookup", "CALL take_ports(1, 'a', 20000, 20001)"),
        ("migrate", "SELECT * FROM mysql.global_priv"),
        ("migrate", "CREATE USER mallory"),
        ("migrate", "GRANT SELECT ON *.* TO web"),
        ("migrate", "SELECT LOAD_FILE('/run/secrets/mysql_web_password') FROM mysql.user"),
        ("web", "SELECT 'x' INTO OUTFILE '/tmp/x'"),
    ],
)
def test_forbidden_statement_is_denied(mariadb: MariaDb, account: str, statement: str) -> None:
    """What an account should not do, the server does not let it do."""
    with (
        connect(mariadb, account) as connection,
        connection.cursor() as cursor,
        pytest.raises(pymysql.MySQLError) as denied,
    ):
        cursor.execute(statement)
    assert denied.value.args[0] in DENIED


@pytest.mark.parametrize("account", ["root", "mysql", ""])
def test_no_other_account_gets_in_over_the_network(mariadb: MariaDb, account: str) -> None:
    """Root exists at the server's own socket only, and nobody is anonymous."""
    settings = mariadb.settings("web")
    with pytest.raises(pymysql.OperationalError, match="Access denied"):
        pymysql.connect(host=settings.host, port=settings.port, user=account, password="")


def test_no_test_database_and_no_anonymous_user(mariadb: MariaDb) -> None:
    """The data directory has what the design names and the server's own."""
    databases = mariadb.as_root("SHOW DATABASES").split()
    assert set(databases) == {
        "information_schema",
        "mysql",
        "performance_schema",
        "robotether",
        "sys",
    }
    users = mariadb.as_root("SELECT user FROM mysql.global_priv").split()
    assert sorted(users) == ["keylookup", "mariadb.sys", "migrate", "mysql", "relay", "root", "web"]


def test_views_answer_although_tables_are_closed(
    mariadb: MariaDb, admin_database: Database
) -> None:
    """The relay and sshd read through views with the rights of their maker."""
    with admin_database.transaction() as tx:
        tx.insert("INSERT INTO robots (mac, name) VALUES ('02:00:00:00:00:01', 'a')")
    with Database(mariadb.settings("relay")).transaction() as tx:
        assert [row["name"] for row in tx.rows("SELECT * FROM relay_robots")] == ["a"]
        for view in ("relay_grants", "relay_logins", "relay_tokens", "relay_changes"):
            tx.rows("SELECT * FROM " + view)
    with Database(mariadb.settings("keylookup")).transaction() as tx:
        assert tx.rows("SELECT * FROM tunnel_keys") == []
        assert tx.rows("SELECT * FROM jump_keys") == []
