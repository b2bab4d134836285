"""Opens transactions on MariaDB, and translates its errors to this package's problems.

Made once by web, relay and cli. Must never log or raise a password or a statement's values.
"""

import datetime as dt
import re
import ssl
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import pymysql
from pymysql.constants import ER, FIELD_TYPE
from pymysql.converters import conversions, convert_datetime
from pymysql.cursors import DictCursor
from pymysql.err import InterfaceError

from robotether_server.problems import (
    RecordExists,
    RecordRefused,
    SettingsError,
    StoreProblem,
    StoreUnavailable,
)
from robotether_server.settings import DatabaseSettings

Row = dict[str, Any]
Values = Sequence[object] | Mapping[str, object]

CONNECT_TIMEOUT_S = 5
ANSWER_TIMEOUT_S = 15
# For each of the two, of who can do without the database.
BRIEF_TIMEOUT_S = 2

# MariaDB's own numbers, which pymysql's table of MySQL's lacks.
CHECK_FAILED = 4025
SIGNALLED = 1644
STATEMENT_TIMEOUT = 1969
TOO_MANY_USER_CONNECTIONS = 1226

_UNAVAILABLE = {
    ER.ACCESS_DENIED_ERROR,
    ER.CON_COUNT_ERROR,
    ER.SERVER_SHUTDOWN,
    ER.LOCK_WAIT_TIMEOUT,
    ER.LOCK_DEADLOCK,
    # It is read-only: a standby that nobody has promoted yet.
    ER.OPTION_PREVENTS_STATEMENT,
    ER.DISK_FULL,
    ER.RECORD_FILE_FULL,
    STATEMENT_TIMEOUT,
    TOO_MANY_USER_CONNECTIONS,
}
_REFUSED = {
    CHECK_FAILED,
    ER.DATA_TOO_LONG,
    ER.BAD_NULL_ERROR,
    ER.WARN_DATA_OUT_OF_RANGE,
    ER.WARN_DATA_TRUNCATED,
    ER.TRUNCATED_WRONG_VALUE_FOR_FIELD,
    ER.NO_REFERENCED_ROW_2,
}
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

    Every method raises StoreUnavailable, RecordExists or RecordRefused; other database errors are
    mistakes in a statement and pass as they are.
    """

    def __init__(self, cursor: DictCursor) -> None:
        self._cursor = cursor

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

    def insert(self, sql: str, values: Values = ()) -> int:
        """Insert one row; return its AUTO_INCREMENT id."""
        with _translated():
            self._cursor.execute(sql, values)
            return self._cursor.lastrowid or 0


class Database:
    """Where the records are. Safe to share between threads: a transaction has its own connection."""

    def __init__(self, settings: DatabaseSettings) -> None:
        """Raise SettingsError when the authority in `settings` cannot be read."""
        self._settings = settings
        self._tls = tls_options(settings)

    @contextmanager
    def transaction(self, *, briefly: bool = False) -> Iterator[Transaction]:
        """Open a transaction; commit when the block ends, roll back when it raises.

        Raises what Transaction's methods raise; `briefly`: within seconds if the database hangs.
        """
        with _translated():
            connection = self._connect(briefly=briefly)
        try:
            with connection.cursor() as cursor:
                yield Transaction(cursor)
            with _translated():
                connection.commit()
        finally:
            # Closing without a commit rolls back, and cannot itself fail on a dead connection.
            connection.close()

    def _connect(self, *, briefly: bool) -> "pymysql.Connection[DictCursor]":
        settings = self._settings
        answer_timeout_s = BRIEF_TIMEOUT_S if briefly else ANSWER_TIMEOUT_S
        return pymysql.connect(
            host=settings.host,
            port=settings.port,
            user=settings.user,
            password=settings.password,
            database=settings.name,
            charset="utf8mb4",
            cursorclass=DictCursor,
            conv=_CONVERSIONS,
            init_command="SET time_zone = '+00:00'",
            **self._tls,
            connect_timeout=BRIEF_TIMEOUT_S if briefly else CONNECT_TIMEOUT_S,
            read_timeout=answer_timeout_s,
            write_timeout=answer_timeout_s,
        )


def tls_options(settings: DatabaseSettings) -> dict[str, Any]:
    """Return what makes pymysql demand TLS, or use none; reads the authority once, for all connections.

    Raises SettingsError.
    """
    if settings.ca_file is None:
        # The network `data` exists on one host only. TLS without a certificate to check would protect nothing there.
        return {"ssl_disabled": True}
    try:
        return {"ssl": ssl.create_default_context(cafile=settings.ca_file)}
    except OSError as error:
        raise SettingsError(
            f"cannot use DB_CA_FILE={str(settings.ca_file)!r}: {error}; "
            "it must be a readable file of certificates in PEM"
        ) from error


@contextmanager
def unique(sentence: str) -> Iterator[None]:
    """Give a RecordExists of the block this sentence for people."""
    try:
        yield
    except RecordExists as error:
        raise RecordExists(sentence, error.key) from error


@contextmanager
def _translated() -> Iterator[None]:
    try:
        yield
    except pymysql.MySQLError as error:
        problem = translate(error)
        if problem is None:
            raise
        raise problem from error


def translate(error: pymysql.MySQLError) -> StoreProblem | None:
    """Return the problem that a database error means, or None when it is a mistake of ours."""
    number = error.args[0] if error.args else 0
    message = str(error.args[1]) if len(error.args) > 1 else str(error)
    if number in _UNAVAILABLE or number in _CLIENT_ERRORS or isinstance(error, InterfaceError):
        return StoreUnavailable(
            "cannot reach the database: it does not answer or is too busy; try again shortly"
        )
    if number == SIGNALLED:
        return RecordRefused(message)
    if number == ER.DUP_ENTRY:
        key = re.search(r"for key '(?:\w+\.)?(\w+)'$", message)
        return RecordExists("cannot save the record: it exists already", key[1] if key else "")
    if number in _REFUSED:
        return RecordRefused(f"cannot save the record: {message}")
    return None
