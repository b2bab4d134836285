"""The settings of web, relay, migrate and the command: frozen objects, read once from the environment.

`VARIABLES` has every variable with its meaning, what is allowed and its default; a field names the one that it is read
from. Each part demands only the variables that it needs, so no part holds another's secrets. No secret has a default,
and none is ever printed.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from ipaddress import IPv4Address, IPv6Address, ip_network
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar, get_origin, get_type_hints

from robotether_server.logs import LogFormat
from robotether_server.problems import SettingsError, reason_in
from robotether_server.times import MAX_TICKET_TTL_S

T = TypeVar("T")

MASK = "********"
BYTES_PER_MB = 1024 * 1024
BYTES_PER_GB = 1000**3
HIGHEST_PORT = 65535
LOWEST_FREE_PORT = 1024
MIN_KEY_LENGTH = 32


class Kind(NamedTuple):
    """What a variable holds: a phrase for people, and the parser, which raises ValueError for all else."""

    allowed: str
    parse: Callable[[str], Any]


@dataclass(frozen=True)
class Variable:
    """One variable of the environment. Default None: it must be set. A secret may come from the file in NAME_FILE."""

    name: str
    meaning: str
    kind: Kind
    default: str | None = None
    secret: bool = False

    @property
    def allowed(self) -> str:
        """What is allowed, for people."""
        return self.kind.allowed

    def read(self, environ: Mapping[str, str]) -> Any:
        """Return the value in force; raise SettingsError, which never shows a secret."""
        text = self.text(environ)
        if text is None:
            also = f" or {self.name}_FILE" if self.secret else ""
            raise SettingsError(
                f"cannot start without {self.name} ({self.meaning}): set it{also}; "
                f"allowed is {self.allowed}"
            )
        try:
            return self.kind.parse(text)
        except ValueError as error:
            what = f"the secret in {self.name}" if self.secret else f"{self.name}={text!r}"
            # The error of a parser has the value, and a traceback would print it.
            raise SettingsError(f"cannot use {what}: allowed is {self.allowed}") from (
                None if self.secret else error
            )

    def text(self, environ: Mapping[str, str]) -> str | None:
        """Return the value as it was written; None: there is none. An empty variable counts as unset."""
        value = environ.get(self.name)
        path = environ.get(f"{self.name}_FILE") if self.secret else None
        if value and path:
            raise SettingsError(
                f"cannot decide which to use: both {self.name} and {self.name}_FILE are set; keep one"
            )
        return value or (self._from_file(path) if path else self.default)

    def _from_file(self, path: str) -> str:
        try:
            return Path(path).read_text(encoding="utf-8").strip()
        except (OSError, UnicodeDecodeError) as error:
            raise SettingsError(
                f"cannot read {self.name}_FILE={path!r}: {reason_in(error)}; it must be a readable text file"
            ) from error


def whole(lowest: int, highest: int, unit: str = "") -> Kind:
    """Whole numbers from `lowest` to `highest`."""

    def parse(text: str) -> int:
        # As all other readers of the variable, too: no sign, blank or zero in front.
        if not re.fullmatch("0|[1-9][0-9]*", text) or not lowest <= int(text) <= highest:
            raise ValueError(text)
        return int(text)

    return Kind(f"{lowest} to {highest}" + (f" ({unit})" if unit else ""), parse)


def matching(pattern: str, allowed: str) -> Kind:
    """Texts that match `pattern` as a whole; an empty one is read as None."""

    def parse(text: str) -> str | None:
        if not re.fullmatch(pattern, text):
            raise ValueError(text)
        return text or None

    return Kind(allowed, parse)


_LABEL = "(?!-)[A-Za-z0-9-]{1,63}(?<!-)"
_HOST_NAME = re.compile(rf"(?=.{{1,253}}\Z){_LABEL}(\.{_LABEL})*")


def _parse_host(text: str) -> str:
    if ":" in text:
        # One before a port would become part of the host, in links and for robots.
        IPv6Address(matching("[0-9A-Fa-f:.]+", "").parse(text))
    elif re.fullmatch("[0-9.]+", text):
        IPv4Address(text)
    elif not _HOST_NAME.fullmatch(text):
        raise ValueError(text)
    return text


def _parse_endpoint(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    return matching("[A-Za-z0-9.-]+", "").parse(host), PORT.parse(port)


def _parse_endpoint_or_empty(text: str) -> str | None:
    if text:
        _parse_endpoint(text)
    return text or None


def _parse_origin(text: str) -> str:
    # As browsers write it: in small letters, and without the usual port.
    origin: str = matching(r"https?://[a-z0-9.-]+(:[0-9]{1,5})?", "").parse(text.strip().lower())
    return origin.removesuffix(":443" if origin.startswith("https:") else ":80")


def _parse_origins(text: str) -> tuple[str, ...]:
    return tuple(_parse_origin(part) for part in text.split(",") if part.strip())


def _parse_networks(text: str) -> tuple[str, ...]:
    parts = [part.strip() for part in text.split(",")] if text else []
    networks = [ip_network(part, strict=False) for part in parts]
    # As images/nginx/networks.sh: what begins with no address is everybody, or half of them; nginx knows no masks.
    if any(network.network_address.is_unspecified for network in networks):
        raise ValueError(text)
    if any("." in part.partition("/")[2] for part in parts):
        raise ValueError(text)
    return tuple(map(str, networks))


def _parse_frame_rate(text: str) -> float:
    if not 1 <= (rate := float(text)) <= 30:  # noqa: PLR2004 - as its Kind says
        raise ValueError(text)
    return rate


_ADDRESS = "[A-Za-z0-9.+_=-]+@[A-Za-z0-9.-]+"

HOST = Kind("a host name or address, without a port", _parse_host)
PORT = whole(1, HIGHEST_PORT)
FREE_PORT = whole(LOWEST_FREE_PORT, HIGHEST_PORT)
MEGABYTES = Kind("1 to 100 (megabytes)", lambda text: whole(1, 100).parse(text) * BYTES_PER_MB)
GIGABYTES = Kind(
    "1 to 100000 (gigabytes)", lambda text: whole(1, 100_000).parse(text) * BYTES_PER_GB
)
HOURS = whole(1, 720, "hours")
FRAMES_PER_S = Kind("1 to 30 (frames a second)", _parse_frame_rate)
KEY = matching(rf"\S{{{MIN_KEY_LENGTH},}}", f"at least {MIN_KEY_LENGTH} characters without spaces")
PATH = Kind("a path", Path)
YES_OR_NO = Kind("no or yes", lambda text: matching("yes|no", "").parse(text) == "yes")
PATH_OR_EMPTY = Kind("a path, or empty", lambda text: Path(text) if text else None)
DRIVETRAIN = matching("differential|holonomic|ackermann", "differential, holonomic or ackermann")
ENDPOINT = Kind("host:port", _parse_endpoint)
ENDPOINT_OR_EMPTY = Kind("host:port, or empty", _parse_endpoint_or_empty)
PORTS = Kind(
    "port numbers with commas between",
    lambda text: tuple(PORT.parse(part.strip()) for part in text.split(",")),
)
ORIGINS = Kind(
    "origins such as https://lab.example, without a path, with commas between, or empty: this site only",
    _parse_origins,
)
HOST_OR_EMPTY = Kind(
    "a host name or address without a port, or empty: the one that each request went to",
    lambda text: _parse_host(text) if text else None,
)
NETWORKS = Kind(
    "networks such as 192.0.2.0/24 with commas between, none of which is everybody, or empty: nobody",
    _parse_networks,
)
ADDRESSES_OR_EMPTY = matching(
    rf"({_ADDRESS}(,{_ADDRESS})*)?", "mail addresses with commas between, or empty: nobody"
)
PASSWORD_OR_EMPTY = matching(
    r"(\S{12,})?",
    "at least 12 characters without spaces, or empty: web makes one and prints it once",
)

_TABLE = (
    Variable("DB_HOST", "host of the database", HOST, "mysql"),
    Variable("DB_PORT", "port of the database", PORT, "3306"),
    Variable(
        "DB_NAME", "name of the database", matching("[a-z0-9_]+", "a-z, 0-9 and _"), "robotether"
    ),
    Variable(
        "DB_USER",
        "account of this part in the database",
        matching("[a-z_]+", "web, relay, recorder or migrate"),
    ),
    Variable(
        "DB_PASSWORD",
        "password of that account",
        matching(r"\S+", "a text without spaces"),
        secret=True,
    ),
    Variable(
        "DB_CA_FILE",
        "authority that signs the database's certificate; empty: no TLS to the database",
        PATH_OR_EMPTY,
        "",
    ),
    Variable("TICKET_KEY", "signs tickets; web, relay and recorder share it", KEY, secret=True),
    Variable(
        "TICKET_TTL_S",
        "how long a ticket opens a connection",
        whole(5, MAX_TICKET_TTL_S, "seconds"),
        "30",
    ),
    Variable("WEB_SECRET_KEY", "signs the forms of the pages; web only", KEY, secret=True),
    Variable("SESSION_KEY", "proves sshd to the relay; both share it", KEY, secret=True),
    Variable(
        "ADMIN_PASSWORD",
        "password of the first admin, whom web or migrate makes when there is no user",
        PASSWORD_OR_EMPTY,
        "",
        secret=True,
    ),
    Variable("LOGIN_TTL_H", "how long a login lasts", HOURS, "12"),
    Variable("LOGIN_IDLE_H", "how long an unused login lasts", HOURS, "4"),
    Variable("WALL_ROBOTS", "how many robots one person watches on the wall", whole(1, 20), "20"),
    Variable(
        "CELL",
        "name of this machine among those of its site",
        matching("[a-z0-9-]{1,63}", "1 to 63 of a-z, 0-9 and -"),
        "main",
    ),
    Variable(
        "REGION",
        "region of this machine, which is first for the robots of that region; empty: none",
        matching("[a-z0-9-]{0,63}", "at most 63 of a-z, 0-9 and -"),
        "",
    ),
    Variable(
        "PEER_ADDRESS",
        "where the site's other machines reach this one",
        ENDPOINT_OR_EMPTY,
        "",
    ),
    Variable(
        "PUBLIC_HOST",
        "name or address under which robots and people reach this site",
        HOST_OR_EMPTY,
        "",
    ),
    Variable("PUBLIC_PORT", "port under which this site is reached at PUBLIC_HOST", PORT, "443"),
    Variable(
        "TLS_FRONT", "where web reads the certificate that this site shows", ENDPOINT, "nginx:8443"
    ),
    Variable(
        "AGENT_FILES_DIR",
        "folder of the installer, the agent's wheel and their manifest",
        PATH,
        "/usr/share/robotether/agent",
    ),
    Variable("SSH_PORTS", "ports at which robots reach sshd, the best first", PORTS, "2222,443"),
    Variable(
        "SSH_HOST_KEYS_DIR", "folder of sshd's public host keys (*.pub)", PATH, "/ssh_host_keys"
    ),
    Variable("TUNNEL_HOST", "host where the robots' forwarded ports listen", HOST, "sshd"),
    Variable("MESSAGE_LIMIT_MB", "largest rosbridge message", MEGABYTES, "10"),
    Variable("ALLOWED_ORIGINS", "other sites whose pages may connect to robots", ORIGINS, ""),
    Variable(
        "DIRECT_PORTS",
        "whether robots accept connections to their published ports, past the relay",
        YES_OR_NO,
        "no",
    ),
    Variable(
        "DIRECT_SOURCES", "networks whose machines may reach the published ports", NETWORKS, ""
    ),
    Variable(
        "TRUSTED_PROXIES",
        "reverse proxies in front, whose header X-Forwarded-For says who asks",
        NETWORKS,
        "",
    ),
    Variable("MAX_PENDING", "how many unknown robots may wait for approval", whole(0, 10000), "50"),
    Variable(
        "JOIN_POLICY",
        "what a robot without a token needs to join",
        matching("approve|first-key|token-only", "approve, first-key or token-only"),
        "approve",
    ),
    Variable(
        "ALLOW_LOCAL_MACS",
        "whether a robot that no admin announced may have a locally administered MAC",
        YES_OR_NO,
        "no",
    ),
    Variable("PORT_RANGE_FIRST", "first port allotted to robots", FREE_PORT, "20000"),
    Variable("PORT_RANGE_LAST", "last port allotted to robots, two a robot", FREE_PORT, "23999"),
    Variable("SHELL_PORT_FIRST", "first port allotted to robots' shells", FREE_PORT, "24000"),
    Variable(
        "SHELL_PORT_LAST", "last port allotted to robots' shells, one a robot", FREE_PORT, "25999"
    ),
    Variable(
        "AUDIT_DAYS",
        "for how many days audit log, drives and sessions are kept; 0: for ever",
        whole(0, 36500),
        "365",
    ),
    Variable("RELAY_HOST", "host of the relay, for the recorder", HOST, "relay"),
    Variable("PROMETHEUS", "where web reads the history of numbers", ENDPOINT, "prometheus:9090"),
    Variable("RECORDINGS_DIR", "folder of the recordings", PATH, "/var/lib/robotether/recordings"),
    Variable(
        "RECORDINGS_MAX_GB",
        "how much all recordings of the site may take; beyond it nothing more is recorded",
        GIGABYTES,
        "20",
    ),
    Variable(
        "RECORDINGS_DAYS",
        "for how many days recordings are kept; 0: for ever",
        whole(0, 36500),
        "30",
    ),
    Variable(
        "DOMAIN",
        "host name for which an authority signs a certificate",
        matching(r"([a-z0-9][a-z0-9-]*(\.[a-z0-9-]+)+)?", "a host name in small letters, or empty"),
        "",
    ),
    Variable(
        "ACME_EMAIL",
        "whom that authority writes to",
        matching(r"(\S+@\S+)?", "a mail address, or empty"),
        "",
    ),
    Variable(
        "ACME_SERVER",
        "directory of that authority",
        matching(r"https://\S+", "an https URL"),
        "https://acme-v02.api.letsencrypt.org/directory",
    ),
    Variable("ALERT_EMAIL_TO", "who gets alerts by mail", ADDRESSES_OR_EMPTY, ""),
    Variable("ALERT_EMAIL_FROM", "sender of these mails", ADDRESSES_OR_EMPTY, ""),
    Variable("ALERT_SMTP", "mail server for them", ENDPOINT_OR_EMPTY, ""),
    Variable("ALERT_SMTP_TLS", "whether that must offer STARTTLS", YES_OR_NO, "yes"),
    Variable(
        "ALERT_SMTP_USER",
        "account at it, with the password in the secret alert_smtp_password",
        matching("[A-Za-z0-9.@+_-]*", "letters, digits and .@+_-, or empty: none"),
        "",
    ),
    Variable(
        "DB_SERVER_ID",
        "number of this machine's database among the two of a standby",
        matching("[12]", "1 or 2"),
        "1",
    ),
    Variable("DB_PARTNER", "the other one of these", ENDPOINT_OR_EMPTY, ""),
    Variable(
        "DB_READ_ONLY",
        "whether this machine's is the standby",
        matching("ON|OFF", "ON or OFF"),
        "OFF",
    ),
    *(
        Variable(
            f"SIM{number}_KIND", f"how the simulated robot sim{number} moves", DRIVETRAIN, kind
        )
        for number, kind in enumerate(("differential", "holonomic", "ackermann"), start=1)
    ),
    *(
        Variable(f"SIM{number}_CAMERAS", f"number of cameras of sim{number}", whole(0, 3), cameras)
        for number, cameras in enumerate(("3", "1", "3"), start=1)
    ),
    Variable("SIM_CAMERA_FPS", "most frames a second of a simulated camera", FRAMES_PER_S, "15"),
    Variable("MIGRATIONS_DIR", "folder of the migrations", PATH, "/usr/share/robotether/sql"),
    Variable(
        "LOG_LEVEL",
        "what is logged",
        matching("debug|info|warning|error", "debug, info, warning or error"),
        "info",
    ),
    Variable(
        "LOG_FORMAT",
        "how it is logged",
        matching("text|json", "text, or json: one object a line"),
        "text",
    ),
)
VARIABLES = {variable.name: variable for variable in _TABLE}


@dataclass(frozen=True)
class DatabaseSettings:
    """Where MariaDB is, and which account to use."""

    host: Annotated[str, "DB_HOST"]
    port: Annotated[int, "DB_PORT"]
    name: Annotated[str, "DB_NAME"]
    user: Annotated[str, "DB_USER"]
    password: Annotated[str, "DB_PASSWORD"] = field(repr=False)
    # None: without TLS.
    ca_file: Annotated[Path | None, "DB_CA_FILE"] = None


@dataclass(frozen=True)
class TicketSettings:
    """What web signs tickets with, and the relay checks them with."""

    key: Annotated[str, "TICKET_KEY"] = field(repr=False)
    ttl_s: Annotated[int, "TICKET_TTL_S"]


@dataclass(frozen=True)
class JoinSettings:
    """How robots join, and where they connect. `public_host` None: the host of their request."""

    policy: Annotated[str, "JOIN_POLICY"]
    max_pending: Annotated[int, "MAX_PENDING"]
    public_host: Annotated[str | None, "PUBLIC_HOST"]
    ssh_ports: Annotated[tuple[int, ...], "SSH_PORTS"]
    ssh_host_keys_dir: Annotated[Path, "SSH_HOST_KEYS_DIR"]
    allow_local_macs: Annotated[bool, "ALLOW_LOCAL_MACS"]


@dataclass(frozen=True)
class SiteAddressSettings:
    """How this site looks from outside. `public_host` None: the host that each request went to."""

    public_host: Annotated[str | None, "PUBLIC_HOST"]
    public_port: Annotated[int, "PUBLIC_PORT"]
    tls_front: Annotated[tuple[str, int], "TLS_FRONT"]


@dataclass(frozen=True)
class WebSettings:
    """All that web needs."""

    database: DatabaseSettings
    tickets: TicketSettings
    join: JoinSettings
    site_address: SiteAddressSettings
    agent_files_dir: Annotated[Path, "AGENT_FILES_DIR"]
    secret_key: Annotated[str, "WEB_SECRET_KEY"] = field(repr=False)
    login_ttl_h: Annotated[int, "LOGIN_TTL_H"]
    login_idle_h: Annotated[int, "LOGIN_IDLE_H"]
    wall_robots: Annotated[int, "WALL_ROBOTS"]
    log_level: Annotated[str, "LOG_LEVEL"]
    allowed_origins: Annotated[tuple[str, ...], "ALLOWED_ORIGINS"] = ()
    # None: web makes one.
    admin_password: Annotated[str | None, "ADMIN_PASSWORD"] = field(default=None, repr=False)
    prometheus: Annotated[tuple[str, int], "PROMETHEUS"] = ("prometheus", 9090)
    log_format: Annotated[LogFormat, "LOG_FORMAT"] = "text"


@dataclass(frozen=True)
class CellSettings:
    """This machine of the site, and where robots and people reach it. `host` None: robots are not sent here."""

    name: Annotated[str, "CELL"]
    host: Annotated[str | None, "PUBLIC_HOST"]
    https_port: Annotated[int, "PUBLIC_PORT"]
    ssh_ports: Annotated[tuple[int, ...], "SSH_PORTS"]
    # None: it has no peers.
    peer_address: Annotated[str | None, "PEER_ADDRESS"]
    region: Annotated[str | None, "REGION"] = None


@dataclass(frozen=True)
class SessionKeySettings:
    """What `robotether audit key` needs."""

    session_key: Annotated[str, "SESSION_KEY"] = field(repr=False)


@dataclass(frozen=True)
class RelaySettings:
    """All that the relay needs."""

    database: DatabaseSettings
    cell: CellSettings
    tickets: TicketSettings
    session_key: Annotated[str, "SESSION_KEY"] = field(repr=False)
    tunnel_host: Annotated[str, "TUNNEL_HOST"]
    allowed_origins: Annotated[tuple[str, ...], "ALLOWED_ORIGINS"]
    message_limit_bytes: Annotated[int, "MESSAGE_LIMIT_MB"]
    log_level: Annotated[str, "LOG_LEVEL"]
    # Robots' ports are published too (compose's service direct): their guards take connections without a key.
    direct: Annotated[bool, "DIRECT_PORTS"] = False
    log_format: Annotated[LogFormat, "LOG_FORMAT"] = "text"


@dataclass(frozen=True)
class RecorderSettings:
    """All that the recorder needs."""

    database: DatabaseSettings
    tickets: TicketSettings
    cell: Annotated[str, "CELL"]
    relay_host: Annotated[str, "RELAY_HOST"]
    folder: Annotated[Path, "RECORDINGS_DIR"]
    max_bytes: Annotated[int, "RECORDINGS_MAX_GB"]
    # 0: for ever.
    days: Annotated[int, "RECORDINGS_DAYS"]
    message_limit_bytes: Annotated[int, "MESSAGE_LIMIT_MB"]
    log_level: Annotated[str, "LOG_LEVEL"]
    log_format: Annotated[LogFormat, "LOG_FORMAT"] = "text"


@dataclass(frozen=True)
class MigrateSettings:
    """All that migrate needs; each range must hold what a robot gets of it, and no port of the other."""

    database: DatabaseSettings
    migrations_dir: Annotated[Path, "MIGRATIONS_DIR"]
    port_range_first: Annotated[int, "PORT_RANGE_FIRST"]
    port_range_last: Annotated[int, "PORT_RANGE_LAST"]
    shell_port_first: Annotated[int, "SHELL_PORT_FIRST"]
    shell_port_last: Annotated[int, "SHELL_PORT_LAST"]
    audit_days: Annotated[int, "AUDIT_DAYS"] = 365
    # None: web makes the first admin.
    admin_password: Annotated[str | None, "ADMIN_PASSWORD"] = field(default=None, repr=False)

    def __post_init__(self) -> None:
        """Raise SettingsError for ranges that do not fit."""
        if self.port_range_last <= self.port_range_first:
            raise SettingsError(
                f"cannot use PORT_RANGE_LAST={self.port_range_last}: "
                f"allowed is more than PORT_RANGE_FIRST={self.port_range_first}"
            )
        if self.shell_port_last < self.shell_port_first:
            raise SettingsError(
                f"cannot use SHELL_PORT_LAST={self.shell_port_last}: "
                f"allowed is SHELL_PORT_FIRST={self.shell_port_first} or more"
            )
        if (
            self.shell_port_first <= self.port_range_last
            and self.port_range_first <= self.shell_port_last
        ):
            raise SettingsError(
                f"cannot use SHELL_PORT_FIRST={self.shell_port_first} and "
                f"SHELL_PORT_LAST={self.shell_port_last}: allowed are ports outside "
                f"PORT_RANGE_FIRST={self.port_range_first} to PORT_RANGE_LAST={self.port_range_last}"
            )


def load(kind: type[T], environ: Mapping[str, str]) -> T:
    """Read the settings of this kind, such as WebSettings; raise SettingsError."""
    read: dict[str, object] = {}
    for name, hint in get_type_hints(kind, include_extras=True).items():
        read[name] = (
            VARIABLES[hint.__metadata__[0]].read(environ)
            if get_origin(hint) is Annotated
            else load(hint, environ)
        )
    return kind(**read)


def in_force(environ: Mapping[str, str]) -> dict[str, str]:
    """Return every variable with its value, secrets masked; an unset one says so. Raises SettingsError."""
    return {variable.name: _masked(variable, environ) for variable in VARIABLES.values()}


def _masked(variable: Variable, environ: Mapping[str, str]) -> str:
    text = variable.text(environ)
    if text is not None:
        variable.read(environ)
    if text is None or (variable.secret and not text):
        return "(not set)"
    return MASK if variable.secret else text
