"""Transactions: all or nothing, times in UTC, and database errors in our own words."""

import socket
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace

import pymysql
import pytest
from dated_certificate import make_certificate
from robotether_server.db import Database
from robotether_server.db import database as module
from robotether_server.db.database import translate
from robotether_server.problems import (
    RecordExistsError,
    RecordRefusedError,
    SettingsError,
    StoreUnavailableError,
)
from robotether_server.settings.server import DatabaseSettings

ADD_USER = "INSERT INTO users (name, password_hash, role) VALUES (%s, 'x', %s)"


def test_database_that_is_not_reached_is_soon_given_up_by_who_can_do_without(monkeypatch):
    monkeypatch.setattr(module, "BRIEF_TIMEOUT_S", 1)
    with socket.create_server(("127.0.0.1", 0), backlog=0) as full, ExitStack() as stack:
        for _ in range(3):
            filler = stack.enter_context(socket.socket())
            filler.setblocking(False)
            filler.connect_ex(full.getsockname())
        nobody = DatabaseSettings(*full.getsockname(), "robotether", "web", "x")
        began_s = time.monotonic()
        with pytest.raises(StoreUnavailableError):
            stack.enter_context(Database(nobody).transaction(briefly=True))
    assert time.monotonic() - began_s < module.CONNECT_TIMEOUT_S - 1


def insert_and_fail(database):
    with pytest.raises(LookupError), database.transaction() as tx:  # noqa: PT012 - what was inserted is rolled back
        tx.insert(ADD_USER, ("ann", "user"))
        raise LookupError


def test_transactions_that_block_each_other_are_all_done(database):
    """The database undoes one of the two, which is done again."""
    with database.transaction() as tx:
        users = [tx.insert(ADD_USER, (name, "user")) for name in ("ann", "ben")]
    both_hold_one = threading.Barrier(2)
    attempts = []

    def change(tx, first, second):
        attempts.append(first)
        tx.change("UPDATE users SET password_hash = 'y' WHERE id = %s", (first,))
        if len(attempts) <= 2:
            both_hold_one.wait(10)
        tx.change("UPDATE users SET name = CONCAT(name, 'x') WHERE id = %s", (second,))
        return first

    with ThreadPoolExecutor() as threads:
        orders = (users, users[::-1])
        done = threads.map(lambda order: database.run(lambda tx: change(tx, *order)), orders)
        assert [*done] == users
    assert len(attempts) == 3
    with database.transaction() as tx:
        names = [row["name"] for row in tx.rows("SELECT name FROM users ORDER BY id")]
    assert names == ["annx", "benx"]


@pytest.mark.parametrize(
    ("name", "role", "problem", "why"),
    [
        ("ann", "user", RecordExistsError, "it exists already"),
        ("Ann", "user", RecordRefusedError, "name has a value that is not allowed"),
        ("bob\n", "user", RecordRefusedError, "name has a value that is not allowed"),
        ("x" * 64, "user", RecordRefusedError, "name is too long"),
        (None, "user", RecordRefusedError, "name is missing"),
        ("bob", "king", RecordRefusedError, "role has a value that is not allowed"),
    ],
)
def test_refused_rows_are_problems(database, name, role, problem, why):
    with database.transaction() as tx:
        tx.insert(ADD_USER, ("ann", "user"))
        with pytest.raises(problem) as refused:
            tx.insert(ADD_USER, (name, role))
    assert refused.value.detail == f"cannot save the record: {why}"


@pytest.mark.parametrize("port", [None, 1], ids=["wrong password", "away"])
def test_server_that_lets_nobody_in_is_unavailable(mariadb, port):
    """The sentence for visitors names no host, and neither shows a secret that is out of step."""
    settings = DatabaseSettings(
        "127.0.0.1", port or mariadb.port, "robotether", "web", "not-the-one"
    )
    with pytest.raises(StoreUnavailableError) as unavailable, Database(settings).transaction():
        pass
    assert "127.0.0.1" not in unavailable.value.detail
    assert "not-the-one" not in f"{unavailable.value.detail} {unavailable.value.__cause__}"


def connection_id(database, *, briefly=False):
    with database.transaction(briefly=briefly) as tx:
        row = tx.row("SELECT CONNECTION_ID() AS id")
    return int(row["id"])


@pytest.fixture
def keeping(mariadb):
    keeping = Database(mariadb.settings("web"), keep=1)
    yield keeping
    keeping.close_kept()


def test_connection_is_kept_for_the_next_transaction_as_long_as_it_is_good(
    keeping, database, mariadb, monkeypatch
):
    first = connection_id(keeping)
    assert connection_id(keeping) == first
    assert connection_id(keeping, briefly=True) != first
    assert connection_id(keeping) == first
    assert connection_id(database) != connection_id(database)
    # A database that was restarted has closed all.
    mariadb.as_root(f"KILL {first}")
    second = connection_id(keeping)
    assert second != first
    # Not for long: the password may be another one by now, or the database another machine's.
    monkeypatch.setattr(module, "KEPT_FOR_S", 0.0)
    assert connection_id(keeping) != second


def test_kept_connection_knows_nothing_of_the_transaction_before(keeping):
    """One that failed, and one with a lock, which holds until its connection ends, are not kept."""
    first = connection_id(keeping)
    insert_and_fail(keeping)
    second = connection_id(keeping)
    assert second != first
    with keeping.transaction() as tx:
        assert tx.rows("SELECT * FROM users") == []
        assert tx.lock("a.test", 0)
    with keeping.transaction() as tx:
        assert tx.row("SELECT IS_FREE_LOCK('a.test') AS free") == {"free": 1}
        assert connection_id(keeping) != second


def test_kept_connections_go_when_another_gets_no_answer(mariadb):
    """They lead to the same database, and who uses one next waits as long."""
    keeping = Database(mariadb.settings("web"), keep=1)
    with pytest.raises(StoreUnavailableError), keeping.transaction() as cut:  # noqa: PT012 - the second is kept meanwhile
        connection_id(keeping)
        assert len(keeping._idle) == 1
        row = cut.row("SELECT CONNECTION_ID() AS id")
        mariadb.as_root(f"KILL {row['id']}")
        cut.rows("SELECT 1")
    assert keeping._idle == []


@pytest.mark.parametrize("number", [1040, 1205, 1213, 1226, 1290, 2003, 2006, 2013])
def test_busy_server_is_unavailable(number):
    """Too many connections, lock waits, deadlocks, a standby and lost connections may go better later."""
    assert isinstance(translate(pymysql.OperationalError(number, "x")), StoreUnavailableError)


def cipher(settings):
    with Database(settings).transaction() as tx:
        row = tx.row("SHOW SESSION STATUS LIKE 'Ssl_cipher'")
    return str(row["Value"])


def test_authority_makes_the_connection_an_encrypted_one(mariadb, tmp_path):
    """The certificate of another authority is refused, and so is that of another host."""
    assert cipher(mariadb.settings("web", mariadb.certificate)).startswith("TLS_")
    assert cipher(mariadb.settings("web")) == ""
    address = mariadb.container.attrs["NetworkSettings"]["IPAddress"]
    elsewhere = replace(mariadb.settings("web"), host=address, port=3306)
    assert cipher(elsewhere) == ""
    for refused in (
        mariadb.settings("web", make_certificate(tmp_path)),
        replace(elsewhere, ca_file=mariadb.certificate),
    ):
        with pytest.raises(StoreUnavailableError):
            cipher(refused)


def test_server_without_tls_gets_no_log_in(mariadb):
    """Somebody between who says so must not see one."""
    greeting = b"\x0a11.8.0-MariaDB\0" + bytes(4) + b"8 chars." + b"\0"
    greeting += (0xF7FF).to_bytes(2, "little") + b"\x2d\x02\0" + (0x81BF).to_bytes(2, "little")
    greeting += b"\x15" + bytes(10) + b"12 more here\0mysql_native_password\0"
    received = []

    def greet():
        connection, _ = listener.accept()
        with connection:
            connection.sendall(len(greeting).to_bytes(3, "little") + b"\0" + greeting)
            received.append(connection.recv(1))

    with socket.create_server(("127.0.0.1", 0)) as listener:
        thread = threading.Thread(target=greet)
        thread.start()
        settings = replace(
            mariadb.settings("web", mariadb.certificate), port=listener.getsockname()[1]
        )
        with pytest.raises(StoreUnavailableError):
            cipher(settings)
        thread.join(timeout=10)
    assert received == [b""]


@pytest.mark.parametrize("text", ["", "no certificate", None])
def test_authority_that_cannot_be_read_stops_the_start(tmp_path, text):
    file = tmp_path / "ca.pem"
    if text is not None:
        file.write_text(text)
    with pytest.raises(SettingsError, match=r"cannot use DB_CA_FILE=.*ca\.pem"):
        Database(DatabaseSettings("127.0.0.1", 1, "robotether", "web", "x", file))
