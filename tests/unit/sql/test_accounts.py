"""What each database account may do: as the server itself says, and as it shows when somebody tries."""

import re

import pymysql
import pytest
from robotether_server.db import Database

EDIT = "SELECT, INSERT, UPDATE, DELETE"
# All that a relay writes of its cell, by name: who drains one is an admin.
CELL = (
    "clock_ahead_s, counted_at, disk_free, heartbeat_at, host, https_port, peer_address, recorders, region, "
    "robots, ssh_ports, started_at, version"
)
# A line of the audit log as of now: of an earlier time relays alone add some.
LINE = "(actor, address, details, kind, robot)"
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
        "audit_events": f"SELECT, INSERT {LINE}",
        "audit_chains": "SELECT",
        "audit_heads": "SELECT",
        "cells": "SELECT, UPDATE (draining)",
        "routes": "SELECT, INSERT, DELETE",
        "PROCEDURE remove_cell": "EXECUTE",
        "help_requests": "SELECT, UPDATE",
        "help_request_passes": EDIT,
        "operators": "SELECT, INSERT, UPDATE",
        "pool_members": "SELECT, INSERT, DELETE",
        "planner": "SELECT, UPDATE",
        "retention": "SELECT",
        "PROCEDURE add_help_request": "EXECUTE",
        "recordings": "SELECT, "
        "INSERT (asked_at, asked_by, asked_by_id, cause, robot, robot_id), "
        "UPDATE (delete_requested_at, downloaded_at, downloaded_by_id, stop_requested_at)",
        "recording_downloads": "SELECT, INSERT, UPDATE",
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
        "audit_chains": "SELECT",
        "audit_heads": "SELECT, INSERT (chain, hash, position, previous, public_key, signature, signer)",
        "relay_routes": "SELECT",
        "relay_lasting_routes": "SELECT",
        "routes": "SELECT (ended_at, id), UPDATE (end_code, ended_at)",
        "cells": f"SELECT, INSERT ({CELL.replace('peer', 'name, peer')}), UPDATE ({CELL})",
        "relay_requests": "SELECT",
        "PROCEDURE ask_for_help": "EXECUTE",
        "PROCEDURE add_robots_head": "EXECUTE",
    },
    "recorder": {
        "recorder_robots": "SELECT",
        "relay_grants": "SELECT",
        "recordings": "SELECT, INSERT (asked_by, asked_by_id, cause, cell, first_asked_at, progress_at, "
        "robot, robot_id, started_at), UPDATE (bytes, cell, deleted_at, drivers, end_code, ended_at, messages, "
        "messages_left_out, progress_at, started_at, topics_left_out)",
        "audit_events": f"INSERT {LINE}",
        "cells": "SELECT (name), UPDATE (recordings_counted_at, recordings_free)",
    },
    "keylookup": {
        "tunnel_keys": "SELECT",
        "jump_keys": "SELECT",
        "PROCEDURE record_refused_key": "EXECUTE",
    },
}


def lines_of(mariadb, account):
    with Database(mariadb.settings(account)).transaction() as tx:
        return [line for row in tx.rows("SHOW GRANTS") for line in row.values()]


def grants_in_force(mariadb, account):
    """Rights by object; the line that only says that the account exists must give nothing."""
    found = {}
    for line in lines_of(mariadb, account):
        rights, place = re.fullmatch(r"GRANT (.*?) ON (.*?) TO .*", line).groups()
        if place == "*.*":
            assert rights == "USAGE"
        else:
            rights = re.sub(r"\(.*?\)", _in_order, rights.replace("`", ""))
            found[place.replace("`", "").replace("robotether.", "")] = rights
        assert "GRANT OPTION" not in line
    return found


def _in_order(columns):
    return f"({', '.join(sorted(columns[0].strip('()').split(', ')))})"


@pytest.mark.parametrize("account", ["web", "relay", "recorder", "keylookup"])
def test_account_has_its_rights_and_no_other(mariadb, account):
    assert grants_in_force(mariadb, account) == EXPECTED[account]


def test_migrate_rules_its_database_and_nothing_global(mariadb):
    none, whole = lines_of(mariadb, "migrate")
    assert none.startswith("GRANT USAGE ON *.* ")
    assert whole == "GRANT ALL PRIVILEGES ON `robotether`.* TO `migrate`@`%` WITH GRANT OPTION"


@pytest.mark.parametrize("account", ["root", "mysql", ""])
def test_no_other_account_gets_in_over_the_network(mariadb, account):
    """Root exists at the server's own socket only, and nobody is anonymous."""
    settings = mariadb.settings("web")
    with pytest.raises(pymysql.OperationalError, match="Access denied"):
        pymysql.connect(host=settings.host, port=settings.port, user=account, password="")


def test_no_test_database_and_no_anonymous_user(mariadb):
    databases = mariadb.as_root("SHOW DATABASES").split()
    schemas = {f"{name}_schema" for name in ("information", "performance")}
    assert set(databases) == {*schemas, "mysql", "robotether", "sys"}
    users = mariadb.as_root("SELECT user FROM mysql.global_priv").split()
    assert set(users) == {"root", "mariadb.sys", "mysql", "migrate", *EXPECTED}
