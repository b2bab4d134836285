"""Sets up the log of a program: lines for people, or with LOG_FORMAT=json one JSON object a line.

Called by web, relay and recorder when they start. A line has the id of the request that it belongs to, which nginx
gives, or of the robot's SSH connection, which sshd's and the agent's logs have, too. It must never hold a ticket,
token or cookie: paths come without their query.
"""

from __future__ import annotations

import json
import logging
import re
from contextvars import ContextVar
from datetime import UTC, datetime
from typing import Literal

from robotether_common.log_handler import LogHandler

LogFormat = Literal["text", "json"]

TEXT = "%(asctime)s %(levelname)s %(name)s: %(message)s"
REQUEST_ID_HEADER = "X-Request-ID"
# What nginx makes of it; a client's own never comes here.
_REQUEST_ID = re.compile(r"[0-9a-f]{32}")
# Maximum length of a path in a line.
MAX_PATH_LENGTH = 200

# Of the request that is answered; None: there is none.
_request_id: ContextVar[str | None] = ContextVar("request_id", default=None)
# Of the robot's connection that is served; None: there is none.
_connection_id: ContextVar[str | None] = ContextVar("connection_id", default=None)


def set_request_id(text: str | None) -> None:
    """Mark all lines of this task or thread as of this request, until the next one begins."""
    _request_id.set(text if text is not None and _REQUEST_ID.fullmatch(text) else None)


def set_connection_id(text: str | None) -> None:
    """Mark all lines of this task as of this SSH connection, until it ends."""
    _connection_id.set(text)


class JsonFormatter(logging.Formatter):
    """Writes a record as one JSON object in one line, whatever is in it."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line."""
        line: dict[str, object] = {
            "at": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
        }
        if (request_id := _request_id.get()) is not None:
            line["request_id"] = request_id
        if (connection_id := _connection_id.get()) is not None:
            line["connection_id"] = connection_id
        line |= getattr(record, "request", {})
        if record.exc_info:
            line["error"] = self.formatException(record.exc_info)
        # Non-ASCII characters are escaped: those that end a line elsewhere, too.
        return json.dumps(line)


def set_up(level: str, log_format: LogFormat) -> None:
    """Write what is logged from `level` on to standard error."""
    logging.basicConfig(level=level.upper(), format=TEXT, handlers=[LogHandler()])
    if log_format == "json":
        write_json(*logging.getLogger().handlers)


def write_json(*handlers: logging.Handler) -> None:
    """Let these handlers write JSON."""
    for handler in handlers:
        handler.setFormatter(JsonFormatter())


class RequestLog:
    """Writes one line a request, with LOG_FORMAT=json alone: nginx has one of each in any case."""

    def __init__(self, log: logging.Logger, log_format: LogFormat) -> None:
        self._log = log
        self._is_json = log_format == "json"

    def write(self, method: str, path: str, status: int, took_s: float) -> None:
        """Write that a request was answered; `path` has no query."""
        if self._is_json:
            request = {
                "method": method[:MAX_PATH_LENGTH],
                "path": path[:MAX_PATH_LENGTH],
                "status": status,
                "took_s": round(took_s, 4),
            }
            self._log.info("request", extra={"request": request})
