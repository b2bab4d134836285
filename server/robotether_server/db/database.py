"""Opens transactions on MariaDB, and translates its errors to this package's problems.

Made once by web, relay and cli. Must never log or raise a password or a statement's values.
"""

import datetime as dt
import re
import select
import ssl
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

import pymysql
from pymysql.constants import ER, FIELD_TYPE
from pymysql.converters import conversions, convert_datetime
from pymysql.cursors import DictCursor
from pymysql.err import InterfaceError

from robotether_server.problems import (
    DeadlockError,
    RecordExistsError,
    RecordRefusedError,
    SettingsError,
    StoreError,
    StoreUnavailableError,
    reason_in,
)
from robotether_server.settings.server import DatabaseSettings

Row = dict[str, Any]
Values = Sequence[object] | Mapping[str, object]
T = TypeVar("T")

CONNECT_TIMEOUT_S = 5
ANSWER_TIMEOUT_S = 15
# Time limit for connecting and for reading, each, of callers that can do without the database.
BRIEF_TIMEOUT_S = 2
# Time for which a connection is kept, since connecting with TLS costs several times a transaction.
# A longer time would outlive another account's password, or another database behind the same name.
KEPT_FOR_S = 60.0
# Maximum number of times that a transaction is done again after a deadlock.
MAX_AGAIN = 4

# Error numbers of MariaDB that pymysql's table of MySQL's lacks.
CHECK_FAILED = 4025
SIGNALLED = 1644
STATEMENT_TIMEOUT = 1969
ACCOUNT_LOCKED = 4151
TOO_MANY_USER_CONNECTIONS = 1226

_UNAVAILABLE = {
    ER.ACCESS_DENIED_ERROR,
    ER.CON_COUNT_ERROR,
    ER.SERVER_SHUTDOWN,
    ER.LOCK_WAIT_TIMEOUT,
    # It is read-only: a standby that nobody has promoted yet.
    ER.OPTION_PREVENTS_STATEMENT,
    ER.DISK_FULL,
    ER.RECORD_FILE_FULL,
    STATEMENT_TIMEOUT,
    TOO_MANY_USER_CONNECTIONS,
    ACCOUNT_LOCKED,
}
# What is wrong with a value, by the database's number. Its own words have tables and statements, and are for nobody.
_REFUSED = {
    CHECK_FAILED: "has a value that is not allowed",
    ER.DATA_TOO_LONG: "is too long",
    ER.BAD_NULL_ERROR: "is missing",
    ER.WARN_DATA_OUT_OF_RANGE: "is out of range",
    ER.WARN_DATA_TRUNCATED: "has a value that is not allowed",
    ER.TRUNCATED_WRONG_VALUE_FOR_FIELD: "has characters that cannot be saved",
    ER.NO_REFERENCED_ROW_2: "names what is not there",
}
# The column that a message names last, or a constraint, which is named after table and column.
_NAMED = re.compile(
    r"[Cc]olumn ['`](?:\w+`\.`)*(\w+)['`]|CONSTRAINT `(?:\w+\.)?(\w+)` failed for `\w+`\.`(\w+)`"
)
_CLIENT_ERRORS = range(2000, 3000)  # the client library's: the connection itself failed


def _utc(text: str) -> Any:
    timestamp = convert_datetime(text)
    return timestamp.replace(tzinfo=dt.UTC) if isinstance(timestamp, dt.datetime) else timestamp


_CONVERSIONS: dict[Any, Any] = {
    **conversions,
    FIELD_TYPE.TIMESTAMP: _utc,
    FIELD_TYPE.DATETIME: _utc,
}


class Transaction:
    """One open transaction. Times go in and come out as aware datetimes in UTC.

    Every method raises StoreUnavailableError, RecordExistsError or RecordRefusedError; other database errors are
    mistakes in a statement and pass as they are.
    """

    def __init__(self, cursor: DictCursor) -> None:
        self._cursor = cursor
        # Named locks end with the connection.
        self.has_lock = False

    def rows(self, sql: str, values: Values = ()) -> list[Row]:
        """Return every row of the answer, by column name."""
        with _translated():
            self._cursor.execute(sql, values)
            return list(self._cursor.fetchall())

    def row(self, sql: str, values: Values = ()) -> Row | None:
        """Return the first row of the answer, or None."""
        with _translated():
            self._cursor.execute(sql, values)
            return self._cursor.fetchone()

    def change(self, sql: str, values: Values = ()) -> int:
        """Run a statement that answers no rows; return how many rows it changed."""
        with _translated():
            return self._cursor.execute(sql, values)

    def change_many(self, sql: str, values: Sequence[Values]) -> int:
        """Run a statement once for each of `values`; return how many rows changed in all."""
        with _translated():
            return self._cursor.executemany(sql, values) or 0

    def now(self) -> dt.datetime:
        """Return the time by the clock of the database, which its records have."""
        [row] = self.rows("SELECT CURRENT_TIMESTAMP(6) AS now")
        return row["now"]  # type: ignore[no-any-return]

    def lock(self, name: str, wait_s: int) -> bool:
        """Take a named lock, which is held until after the commit; False if it is not free within `wait_s`."""
        self.has_lock = True
        row = self.row("SELECT GET_LOCK(%s, %s) AS held", (name, wait_s))
        return row is not None and row["held"] == 1

    def insert(self, sql: str, values: Values = ()) -> int:
        """Insert one row; return its AUTO_INCREMENT id."""
        with _translated():
            self._cursor.execute(sql, values)
            return self._cursor.lastrowid or 0

    def add(self, table: str, values: Mapping[str, object], rest: str = "") -> int:
        """Insert one row of values by column, with the rest of the statement; return its AUTO_INCREMENT id."""
        columns = ", ".join(f"`{column}`" for column in values)
        places = ", ".join(f"%({column})s" for column in values)
        return self.insert(f"INSERT INTO {table} ({columns}) VALUES ({places}) {rest}", values)  # noqa: S608 - the modules' own names

    def update(self, table: str, row_id: int, values: Mapping[str, object]) -> None:
        """Set columns of the row of that id."""
        changes = ", ".join(f"`{column}` = %({column})s" for column in values)
        self.change(f"UPDATE {table} SET {changes} WHERE id = %(id)s", {**values, "id": row_id})  # noqa: S608 - as above


@dataclass(frozen=True)
class _Connection:
    """A connection to the database, and what it was opened for."""

    mysql: "pymysql.Connection[DictCursor]"
    briefly: bool
    opened_at: float

    def is_good(self) -> bool:
        """Whether it may be used again: it is not old, and the database has neither closed it nor said anything."""
        if time.monotonic() - self.opened_at > KEPT_FOR_S:
            return False
        poll = select.poll()
        # The library has no question for this that does not wait for an answer.
        poll.register(self.mysql._sock, select.POLLIN)  # type: ignore[attr-defined]
        return not poll.poll(0)


class Database:
    """Where the records are. Safe to share between threads: a transaction has a connection to itself."""

    def __init__(self, settings: DatabaseSettings, *, keep: int = 0) -> None:
        """Keep up to `keep` connections for the next transactions.

        Raise SettingsError when the authority in `settings` cannot be read.
        """
        self._options = connect_options(settings)
        self._keep = keep
        self._lock = threading.Lock()
        # Those that nobody uses, the newest last.
        self._idle: list[_Connection] = []

    @contextmanager
    def transaction(self, *, briefly: bool = False) -> Iterator[Transaction]:
        """Open a transaction; commit when the block ends, roll back when it raises.

        Raises what Transaction's methods raise; `briefly`: within seconds if the database hangs.
        """
        with _translated():
            connection = self._reuse(briefly=briefly) or self._connect(briefly=briefly)
        again = False
        try:
            with connection.mysql.cursor() as cursor:
                tx = Transaction(cursor)
                yield tx
            with _translated():
                connection.mysql.commit()
            again = not tx.has_lock
        except DeadlockError:
            raise
        except StoreUnavailableError:
            self.close_kept()
            raise
        finally:
            # Closing without a commit rolls back, and cannot itself fail on a dead connection.
            if not (again and self._keep_for_next(connection)):
                connection.mysql.close()

    def run(
        self, work: Callable[[Transaction], T], *, briefly: bool = False, again: int = MAX_AGAIN
    ) -> T:
        """Do `work` in a transaction, and up to `again` times anew if the database undoes it in a deadlock.

        Returns its result; raises as `transaction` does. `work` must leave nothing behind but in its transaction.
        """
        try:
            with self.transaction(briefly=briefly) as tx:
                return work(tx)
        except DeadlockError:
            if again == 0:
                raise
        return self.run(work, briefly=briefly, again=again - 1)

    def close_kept(self) -> None:
        """Let go of the connections that nobody uses: one to the same database has got no answer."""
        with self._lock:
            connections, self._idle = self._idle, []
        for connection in connections:
            connection.mysql.close()

    def _reuse(self, *, briefly: bool) -> _Connection | None:
        with self._lock:
            connections, self._idle = self._idle, []
            good = [connection for connection in connections if connection.is_good()]
            connection = next(
                (connection for connection in reversed(good) if connection.briefly == briefly), None
            )
            self._idle = [other for other in good if other is not connection]
        for other in connections:
            if other not in good:
                other.mysql.close()
        return connection

    def _keep_for_next(self, connection: _Connection) -> bool:
        """Keep a connection; False when there is no room."""
        with self._lock:
            if len(self._idle) >= self._keep:
                return False
            self._idle.append(connection)
        return True

    def _connect(self, *, briefly: bool) -> _Connection:
        answer_timeout_s = BRIEF_TIMEOUT_S if briefly else ANSWER_TIMEOUT_S
        opened_at = time.monotonic()
        mysql = pymysql.connect(
            **self._options,
            cursorclass=DictCursor,
            conv=_CONVERSIONS,
            init_command="SET time_zone = '+00:00'",
            connect_timeout=BRIEF_TIMEOUT_S if briefly else CONNECT_TIMEOUT_S,
            read_timeout=answer_timeout_s,
            write_timeout=answer_timeout_s,
        )
        return _Connection(mysql, briefly, opened_at)


def connect_options(settings: DatabaseSettings) -> dict[str, Any]:
    """Return pymysql's arguments for this account; reads the authority once, for all connections.

    Raises SettingsError.
    """
    return {
        "host": settings.host,
        "port": settings.port,
        "user": settings.user,
        "password": settings.password,
        "database": settings.name,
        "charset": "utf8mb4",
        **_tls_options(settings),
    }


def _tls_options(settings: DatabaseSettings) -> dict[str, Any]:
    """Return what makes pymysql demand TLS, or use none."""
    if settings.ca_file is None:
        # The network `data` exists on one host only. TLS without a certificate to check would protect nothing there.
        return {"ssl_disabled": True}
    try:
        return {"ssl": ssl.create_default_context(cafile=settings.ca_file)}
    except OSError as error:
        raise SettingsError(
            f"cannot use DB_CA_FILE={str(settings.ca_file)!r}: {reason_in(error)}; "
            "it must be a readable file of certificates in PEM"
        ) from error


@contextmanager
def unique(sentence: str) -> Iterator[None]:
    """Give a RecordExistsError of the block this sentence for people."""
    try:
        yield
    except RecordExistsError as error:
        raise RecordExistsError(sentence, error.key) from error


@contextmanager
def _translated() -> Iterator[None]:
    try:
        yield
    except pymysql.MySQLError as error:
        problem = translate(error)
        if problem is None:
            raise
        raise problem from error


def translate(error: pymysql.MySQLError) -> StoreError | None:
    """Return the problem that a database error means, or None when it is a mistake of ours."""
    number = error.args[0] if error.args else 0
    message = str(error.args[1]) if len(error.args) > 1 else str(error)
    if number == ER.LOCK_DEADLOCK:
        return DeadlockError("cannot save: others change the same records; try again shortly")
    if number in _UNAVAILABLE or number in _CLIENT_ERRORS or isinstance(error, InterfaceError):
        return StoreUnavailableError(
            "cannot use the database: tools/restore has not finished; if it was interrupted, run it again"
            if number == ACCOUNT_LOCKED
            else "cannot reach the database: it does not answer or is too busy; try again shortly"
        )
    if number == SIGNALLED:
        return RecordRefusedError(message)
    if number == ER.DUP_ENTRY:
        key = re.search(r"for key '(?:\w+\.)?(\w+)'$", message)
        return RecordExistsError("cannot save the record: it exists already", key[1] if key else "")
    if number in _REFUSED:
        return RecordRefusedError(
            f"cannot save the record: {_field_of(message)} {_REFUSED[number]}"
        )
    return None


def _field_of(message: str) -> str:
    match = _NAMED.search(message)
    if match is None:
        return "a field"
    column, constraint, table = match.groups()
    return str(column or constraint.removeprefix(f"{table}_"))
