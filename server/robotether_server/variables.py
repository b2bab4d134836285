"""Every variable of the environment that the server knows: meaning, allowed values, default.

Read by settings.py, and by the test that compares .env.example and compose.yaml with it.
No secret has a default.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

from robotether_server.problems import SettingsError

T_co = TypeVar("T_co", covariant=True)

HIGHEST_PORT = 65535
LOWEST_FREE_PORT = 1024
MIN_KEY_LENGTH = 32


@dataclass(frozen=True)
class Variable(Generic[T_co]):
    """One variable. `parse` raises ValueError for what is not allowed; default None: must be set."""

    name: str
    meaning: str
    allowed: str
    parse: Callable[[str], T_co]
    default: str | None = None
    secret: bool = False

    def read(self, environ: Mapping[str, str]) -> T_co:
        """Return the value in force; raise SettingsError, which never shows a secret."""
        text = self.text(environ)
        try:
            return self.parse(text)
        except ValueError as error:
            what = f"the secret in {self.name}" if self.secret else f"{self.name}={text!r}"
            # The error of a parser has the value, and a traceback would print it.
            raise SettingsError(f"cannot use {what}: allowed is {self.allowed}") from (
                None if self.secret else error
            )

    def is_set(self, environ: Mapping[str, str]) -> bool:
        """Tell whether there is a value; an empty variable counts as unset."""
        from_file = self.secret and environ.get(f"{self.name}_FILE")
        return bool(environ.get(self.name) or from_file or self.default is not None)

    def text(self, environ: Mapping[str, str]) -> str:
        """Return the value as it was written."""
        given = environ.get(self.name)
        path = environ.get(f"{self.name}_FILE") if self.secret else None
        if given and path:
            raise SettingsError(
                f"cannot decide which to use: both {self.name} and {self.name}_FILE are set; keep one"
            )
        text = given or (self._from_file(path) if path else self.default)
        if text is None:
            also = f" or {self.name}_FILE" if self.secret else ""
            raise SettingsError(
                f"cannot start without {self.name} ({self.meaning}): set it{also}; "
                f"allowed is {self.allowed}"
            )
        return text

    def _from_file(self, path: str) -> str:
        try:
            return Path(path).read_text(encoding="utf-8").strip()
        except (OSError, UnicodeDecodeError) as error:
            raise SettingsError(
                f"cannot read {self.name}_FILE={path!r}: {error}; it must be a readable text file"
            ) from error


def number(lowest: int, highest: int) -> Callable[[str], int]:
    """Make a parser of whole numbers from `lowest` to `highest`."""

    def parse(text: str) -> int:
        value = int(text)
        if not lowest <= value <= highest:
            raise ValueError(text)
        return value

    return parse


def matching(pattern: str) -> Callable[[str], str]:
    """Make a parser of texts that match `pattern` as a whole."""

    def parse(text: str) -> str:
        if not re.fullmatch(pattern, text):
            raise ValueError(text)
        return text

    return parse


def parse_yes(text: str) -> bool:
    """Parse `yes` or `no`."""
    return matching("yes|no")(text) == "yes"


def parse_ports(text: str) -> tuple[int, ...]:
    """Parse `2222,443`."""
    port = number(1, HIGHEST_PORT)
    return tuple(port(part) for part in text.split(","))


def parse_endpoint(text: str) -> tuple[str, int]:
    """Parse `nginx:8443`."""
    host, _, port = text.rpartition(":")
    return matching(r"[A-Za-z0-9.-]+")(host), number(1, HIGHEST_PORT)(port)


def parse_origins(text: str) -> tuple[str, ...]:
    """Parse `https://a.example,https://b.example:8443`; empty is none."""
    origin = matching(r"https?://[a-z0-9.-]+(:[0-9]{1,5})?")
    return tuple(origin(part.strip()) for part in text.split(",") if part.strip())


_HOST = r"[A-Za-z0-9.:-]+"
_KEY = matching(rf"\S{{{MIN_KEY_LENGTH},}}")
_KEY_ALLOWED = f"at least {MIN_KEY_LENGTH} characters without spaces"
_PORTS_ALLOWED = f"{LOWEST_FREE_PORT} to {HIGHEST_PORT}"

DB_HOST = Variable("DB_HOST", "host of the database", "a host name", matching(_HOST), "mysql")
DB_PORT = Variable(
    "DB_PORT", "port of the database", f"1 to {HIGHEST_PORT}", number(1, HIGHEST_PORT), "3306"
)
DB_NAME = Variable(
    "DB_NAME", "name of the database", "a-z, 0-9 and _", matching("[a-z0-9_]+"), "robotether"
)
DB_USER = Variable(
    "DB_USER", "account of this part in the database", "web, relay or migrate", matching("[a-z_]+")
)
DB_PASSWORD = Variable(
    "DB_PASSWORD",
    "password of that account",
    "a text without spaces",
    matching(r"\S+"),
    secret=True,
)
TICKET_KEY = Variable(
    "TICKET_KEY", "signs tickets; web and relay share it", _KEY_ALLOWED, _KEY, secret=True
)
TICKET_TTL_S = Variable(
    "TICKET_TTL_S",
    "how long a ticket opens a connection",
    "5 to 300 (seconds)",
    number(5, 300),
    "30",
)
WEB_SECRET_KEY = Variable(
    "WEB_SECRET_KEY", "signs the forms of the pages; web only", _KEY_ALLOWED, _KEY, secret=True
)
SESSION_KEY = Variable(
    "SESSION_KEY", "proves sshd to the relay; both share it", _KEY_ALLOWED, _KEY, secret=True
)
ADMIN_PASSWORD = Variable(
    "ADMIN_PASSWORD",
    "password of the first admin, whom web makes when there is no user",
    "at least 12 characters without spaces, or empty: web makes one and prints it once",
    matching(r"(\S{12,})?"),
    "",
    secret=True,
)
LOGIN_TTL_H = Variable(
    "LOGIN_TTL_H", "how long a login lasts", "1 to 720 (hours)", number(1, 720), "12"
)
LOGIN_IDLE_H = Variable(
    "LOGIN_IDLE_H",
    "how long an unused login lasts",
    "1 to 720 (hours)",
    number(1, 720),
    "4",
)
PUBLIC_HOST = Variable(
    "PUBLIC_HOST",
    "name or address under which robots and people reach this site",
    "a host name, or empty: the one that each request went to",
    matching(f"({_HOST})?"),
    "",
)
PUBLIC_PORT = Variable(
    "PUBLIC_PORT",
    "port under which this site is reached at PUBLIC_HOST",
    f"1 to {HIGHEST_PORT}",
    number(1, HIGHEST_PORT),
    "443",
)
TLS_FRONT = Variable(
    "TLS_FRONT",
    "where web reads the certificate that this site shows",
    "host:port",
    parse_endpoint,
    "nginx:8443",
)
AGENT_FILES_DIR = Variable(
    "AGENT_FILES_DIR",
    "folder of the installer, the agent's wheel and their manifest",
    "a path",
    Path,
    "/usr/share/robotether/agent",
)
SSH_PORTS = Variable(
    "SSH_PORTS",
    "ports at which robots reach sshd, the best first",
    "port numbers with commas between",
    parse_ports,
    "2222,443",
)
SSH_HOST_KEYS_DIR = Variable(
    "SSH_HOST_KEYS_DIR",
    "folder of sshd's public host keys (*.pub)",
    "a path",
    Path,
    "/ssh_host_keys",
)
TUNNEL_HOST = Variable(
    "TUNNEL_HOST",
    "host where the robots' forwarded ports listen",
    "a host name",
    matching(_HOST),
    "sshd",
)
MESSAGE_LIMIT_MB = Variable(
    "MESSAGE_LIMIT_MB", "largest rosbridge message", "1 to 100 (megabytes)", number(1, 100), "10"
)
ALLOWED_ORIGINS = Variable(
    "ALLOWED_ORIGINS",
    "other sites whose pages may connect to robots",
    "origins such as https://lab.example with commas between, or empty: this site only",
    parse_origins,
    "",
)
DIRECT_PORTS = Variable(
    "DIRECT_PORTS",
    "whether robots accept connections to their published ports, past the relay",
    "no or yes",
    parse_yes,
    "no",
)
MAX_PENDING = Variable(
    "MAX_PENDING",
    "how many unknown robots may wait for approval",
    "0 to 10000",
    number(0, 10000),
    "50",
)
JOIN_POLICY = Variable(
    "JOIN_POLICY",
    "what a robot without a token needs to join",
    "approve, first-key or token-only",
    matching("approve|first-key|token-only"),
    "approve",
)
ALLOW_LOCAL_MACS = Variable(
    "ALLOW_LOCAL_MACS",
    "whether a robot that no admin announced may have a locally administered MAC",
    "no or yes",
    parse_yes,
    "no",
)
PORT_RANGE_FIRST = Variable(
    "PORT_RANGE_FIRST",
    "first port allotted to robots",
    _PORTS_ALLOWED,
    number(LOWEST_FREE_PORT, HIGHEST_PORT),
    "20000",
)
PORT_RANGE_LAST = Variable(
    "PORT_RANGE_LAST",
    "last port allotted to robots, two a robot",
    _PORTS_ALLOWED,
    number(LOWEST_FREE_PORT, HIGHEST_PORT),
    "23999",
)
SHELL_PORT_FIRST = Variable(
    "SHELL_PORT_FIRST",
    "first port allotted to robots' shells",
    _PORTS_ALLOWED,
    number(LOWEST_FREE_PORT, HIGHEST_PORT),
    "24000",
)
SHELL_PORT_LAST = Variable(
    "SHELL_PORT_LAST",
    "last port allotted to robots' shells, one a robot",
    _PORTS_ALLOWED,
    number(LOWEST_FREE_PORT, HIGHEST_PORT),
    "25999",
)
AUDIT_DAYS = Variable(
    "AUDIT_DAYS",
    "for how many days audit log, drives and sessions are kept; 0: for ever",
    "0 to 36500",
    number(0, 36500),
    "365",
)
MIGRATIONS_DIR = Variable(
    "MIGRATIONS_DIR", "folder of the migrations", "a path", Path, "/usr/share/robotether/sql"
)
LOG_LEVEL = Variable(
    "LOG_LEVEL",
    "what is logged",
    "debug, info, warning or error",
    matching("debug|info|warning|error"),
    "info",
)

VARIABLES: tuple[Variable[object], ...] = (
    DB_HOST,
    DB_PORT,
    DB_NAME,
    DB_USER,
    DB_PASSWORD,
    TICKET_KEY,
    TICKET_TTL_S,
    WEB_SECRET_KEY,
    SESSION_KEY,
    ADMIN_PASSWORD,
    LOGIN_TTL_H,
    LOGIN_IDLE_H,
    PUBLIC_HOST,
    PUBLIC_PORT,
    TLS_FRONT,
    AGENT_FILES_DIR,
    SSH_PORTS,
    SSH_HOST_KEYS_DIR,
    TUNNEL_HOST,
    MESSAGE_LIMIT_MB,
    ALLOWED_ORIGINS,
    DIRECT_PORTS,
    MAX_PENDING,
    JOIN_POLICY,
    ALLOW_LOCAL_MACS,
    PORT_RANGE_FIRST,
    PORT_RANGE_LAST,
    SHELL_PORT_FIRST,
    SHELL_PORT_LAST,
    AUDIT_DAYS,
    MIGRATIONS_DIR,
    LOG_LEVEL,
)
