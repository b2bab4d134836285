"""The settings in force: frozen objects for web, relay, migrate and the cli, one group a need.

Made once at a start from the environment, which nothing else reads. Each part demands only the
variables that it needs, so no part holds another's secrets. Must never print a secret.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from robotether_server import variables as v
from robotether_server.problems import SettingsError

MASK = "********"
BYTES_PER_MB = 1024 * 1024


@dataclass(frozen=True)
class DatabaseSettings:
    """Where MariaDB is, and which account to use."""

    host: str
    port: int
    name: str
    user: str
    password: str = field(repr=False)


@dataclass(frozen=True)
class TicketSettings:
    """What web signs tickets with, and the relay checks them with."""

    key: str = field(repr=False)
    ttl_s: int


@dataclass(frozen=True)
class JoinSettings:
    """How robots join, and where they connect. `public_host` None: the host of their request."""

    policy: str
    max_pending: int
    public_host: str | None
    ssh_ports: tuple[int, ...]
    ssh_host_keys_dir: Path
    allow_local_macs: bool


@dataclass(frozen=True)
class SiteAddressSettings:
    """How this site looks from outside. `public_host` None: the host that each request went to."""

    public_host: str | None
    public_port: int
    tls_front: tuple[str, int]


@dataclass(frozen=True)
class WebSettings:
    """All that web needs."""

    database: DatabaseSettings
    tickets: TicketSettings
    join: JoinSettings
    site_address: SiteAddressSettings
    agent_files_dir: Path
    secret_key: str = field(repr=False)
    login_ttl_h: int
    login_idle_h: int
    log_level: str
    allowed_origins: tuple[str, ...] = ()
    # None: web makes one.
    admin_password: str | None = field(default=None, repr=False)


@dataclass(frozen=True)
class RelaySettings:
    """All that the relay needs."""

    database: DatabaseSettings
    tickets: TicketSettings
    session_key: str = field(repr=False)
    tunnel_host: str
    public_host: str | None
    allowed_origins: tuple[str, ...]
    message_limit_bytes: int
    log_level: str
    # Robots' ports are published too (compose's service direct): their guards take connections without a key.
    direct: bool = False


@dataclass(frozen=True)
class MigrateSettings:
    """All that migrate needs."""

    database: DatabaseSettings
    migrations_dir: Path
    port_range_first: int
    port_range_last: int
    shell_port_first: int
    shell_port_last: int
    audit_days: int = 365


def load_database(environ: Mapping[str, str]) -> DatabaseSettings:
    """Read what every part needs."""
    return DatabaseSettings(
        host=v.DB_HOST.read(environ),
        port=v.DB_PORT.read(environ),
        name=v.DB_NAME.read(environ),
        user=v.DB_USER.read(environ),
        password=v.DB_PASSWORD.read(environ),
    )


def load_tickets(environ: Mapping[str, str]) -> TicketSettings:
    """Read what web and relay share."""
    return TicketSettings(key=v.TICKET_KEY.read(environ), ttl_s=v.TICKET_TTL_S.read(environ))


def load_join(environ: Mapping[str, str]) -> JoinSettings:
    """Read how robots join."""
    return JoinSettings(
        policy=v.JOIN_POLICY.read(environ),
        max_pending=v.MAX_PENDING.read(environ),
        public_host=v.PUBLIC_HOST.read(environ) or None,
        ssh_ports=v.SSH_PORTS.read(environ),
        ssh_host_keys_dir=v.SSH_HOST_KEYS_DIR.read(environ),
        allow_local_macs=v.ALLOW_LOCAL_MACS.read(environ),
    )


def load_site_address(environ: Mapping[str, str]) -> SiteAddressSettings:
    """Read what the line that installs a robot needs."""
    return SiteAddressSettings(
        public_host=v.PUBLIC_HOST.read(environ) or None,
        public_port=v.PUBLIC_PORT.read(environ),
        tls_front=v.TLS_FRONT.read(environ),
    )


def load_web(environ: Mapping[str, str]) -> WebSettings:
    """Read what web needs."""
    return WebSettings(
        database=load_database(environ),
        tickets=load_tickets(environ),
        join=load_join(environ),
        site_address=load_site_address(environ),
        agent_files_dir=v.AGENT_FILES_DIR.read(environ),
        secret_key=v.WEB_SECRET_KEY.read(environ),
        login_ttl_h=v.LOGIN_TTL_H.read(environ),
        login_idle_h=v.LOGIN_IDLE_H.read(environ),
        log_level=v.LOG_LEVEL.read(environ),
        allowed_origins=v.ALLOWED_ORIGINS.read(environ),
        admin_password=v.ADMIN_PASSWORD.read(environ) or None,
    )


def load_relay(environ: Mapping[str, str]) -> RelaySettings:
    """Read what the relay needs."""
    return RelaySettings(
        database=load_database(environ),
        tickets=load_tickets(environ),
        session_key=v.SESSION_KEY.read(environ),
        tunnel_host=v.TUNNEL_HOST.read(environ),
        public_host=v.PUBLIC_HOST.read(environ) or None,
        allowed_origins=v.ALLOWED_ORIGINS.read(environ),
        message_limit_bytes=v.MESSAGE_LIMIT_MB.read(environ) * BYTES_PER_MB,
        log_level=v.LOG_LEVEL.read(environ),
        direct=v.DIRECT_PORTS.read(environ),
    )


def load_migrate(environ: Mapping[str, str]) -> MigrateSettings:
    """Read what migrate needs; each range must hold what a robot gets of it, and no port of the other."""
    settings = MigrateSettings(
        database=load_database(environ),
        migrations_dir=v.MIGRATIONS_DIR.read(environ),
        port_range_first=v.PORT_RANGE_FIRST.read(environ),
        port_range_last=v.PORT_RANGE_LAST.read(environ),
        shell_port_first=v.SHELL_PORT_FIRST.read(environ),
        shell_port_last=v.SHELL_PORT_LAST.read(environ),
        audit_days=v.AUDIT_DAYS.read(environ),
    )
    _check_ranges(settings)
    return settings


def _check_ranges(settings: MigrateSettings) -> None:
    if settings.port_range_last <= settings.port_range_first:
        raise SettingsError(
            f"cannot use PORT_RANGE_LAST={settings.port_range_last}: "
            f"allowed is more than PORT_RANGE_FIRST={settings.port_range_first}"
        )
    if settings.shell_port_last < settings.shell_port_first:
        raise SettingsError(
            f"cannot use SHELL_PORT_LAST={settings.shell_port_last}: "
            f"allowed is SHELL_PORT_FIRST={settings.shell_port_first} or more"
        )
    if (
        settings.shell_port_first <= settings.port_range_last
        and settings.port_range_first <= settings.shell_port_last
    ):
        raise SettingsError(
            f"cannot use SHELL_PORT_FIRST={settings.shell_port_first} and "
            f"SHELL_PORT_LAST={settings.shell_port_last}: allowed are ports outside "
            f"PORT_RANGE_FIRST={settings.port_range_first} to PORT_RANGE_LAST={settings.port_range_last}"
        )


def in_force(environ: Mapping[str, str]) -> dict[str, str]:
    """Return every variable with its value, secrets masked; an unset one says so."""
    return {variable.name: _shown(variable, environ) for variable in v.VARIABLES}


def _shown(variable: v.Variable[object], environ: Mapping[str, str]) -> str:
    if not variable.is_set(environ):
        return "(not set)"
    variable.read(environ)
    text = variable.text(environ)
    if variable.secret:
        return MASK if text else "(not set)"
    return text
