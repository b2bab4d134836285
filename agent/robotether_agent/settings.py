"""The agent's settings: agent.toml and ROBOTETHER_<KEY> of the environment, read once by the cli.

Everything else gets the frozen Settings as an argument. A wrong value stops the start and names the file
or variable, the key, the value and what is allowed. Secrets never reach a log or `show-settings`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from robotether_agent import setting_values as parse
from robotether_agent.fields import MacError, normalise_mac
from robotether_agent.problems import SettingsInvalid

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

DEFAULT_FILE = Path("/etc/robotether/agent.toml")
HTTPS = 443
PREFIX = "ROBOTETHER_"
SECRETS = frozenset({"token"})
# A password may stand in these URLs.
URLS_WITH_LOGIN = frozenset({"http_proxy", "cameras"})

PARSERS: dict[str, Callable[[object], Any]] = {
    "server": parse.server,
    "tls_fingerprint": parse.fingerprint,
    "ca_file": parse.path,
    "ssh_host": parse.host,
    "ssh_ports": parse.ports,
    "http_proxy": parse.http_proxy,
    "interface": parse.interface,
    "mac": parse.mac,
    "name": parse.robot_name,
    "allow_local_mac": parse.flag,
    "rosbridge_url": parse.rosbridge_url,
    "video_url": parse.video_url,
    "video_source": parse.video_source,
    "cameras": parse.cameras,
    "shell_address": parse.shell_address,
    "guard": parse.on_off,
    "state_dir": parse.path,
    "run_dir": parse.run_dir,
    "token": parse.text,
    "token_file": parse.path,
    "log_level": parse.log_level,
}
EXCLUSIVE = (("tls_fingerprint", "ca_file"), ("token", "token_file"), ("interface", "mac"))


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What is in force; agent.toml.example says what each key means."""

    server: str
    tls_fingerprint: bytes | None = None
    ca_file: Path | None = None
    ssh_host: str | None = None
    ssh_ports: tuple[int, ...] | None = None
    http_proxy: str | None = field(default=None, repr=False)
    interface: str | None = None
    mac: str | None = None
    allow_local_mac: bool = False
    name: str | None = None
    rosbridge_url: str = "ws://127.0.0.1:9090"
    video_url: str = "http://127.0.0.1:8080"
    video_source: str = "auto"
    # NAME=URL each; a password may stand in a URL.
    cameras: tuple[str, ...] = field(default=(), repr=False)
    shell_address: str = "127.0.0.1:22"
    guard: str = "on"
    state_dir: Path = Path("/var/lib/robotether-agent")
    run_dir: Path = Path("/run/robotether-agent")
    token: str | None = field(default=None, repr=False)
    token_file: Path | None = None
    log_level: str = "info"

    @property
    def server_host(self) -> str:
        """The server's host without the port and without brackets."""
        return urlsplit(f"//{self.server}").hostname or self.server

    @property
    def server_port(self) -> int:
        """The server's https port."""
        return urlsplit(f"//{self.server}").port or HTTPS

    def join_token(self) -> str | None:
        """Return the join token, read when it is needed: an enrolled robot may have lost the file."""
        if self.token_file is None:
            return self.token
        try:
            return self.token_file.read_text(encoding="ascii").strip() or None
        except (OSError, UnicodeDecodeError) as error:
            raise SettingsInvalid(
                f"cannot read the join token in {self.token_file}, which token_file names: {error}",
                advice="put the token there, or remove token_file from the settings",
            ) from error


@dataclass(frozen=True)
class _Given:
    """One value as it was given, and where."""

    key: str
    value: object
    source: str

    def refuse(self, why: str) -> SettingsInvalid:
        hidden = self.key in SECRETS | URLS_WITH_LOGIN
        # A password may stand in any URL, and in most of them it is what is refused.
        value = parse.without_login(self.value) if isinstance(self.value, str) else self.value
        shown = "(hidden)" if hidden else repr(value)
        return SettingsInvalid(f"cannot use {self.source} = {shown}: {why}", advice="correct it")


def load(file: Path | None, environ: Mapping[str, str], *, needs_server: bool = True) -> Settings:
    """Return the settings from `file` (None: the usual one, if it is there) and `environ`.

    Without `needs_server` the server may be missing, and is then the empty text.
    """
    source = DEFAULT_FILE if file is None else file
    given = _from_file(source, must_exist=file is not None)
    given.update(_from_environment(environ))
    if "server" not in given and needs_server:
        raise SettingsInvalid(
            f"cannot start: server is set neither in {source} nor as {PREFIX}SERVER",
            advice="set it to the server's host name or address, or HOST:PORT",
        )
    _refuse_both(given)
    settings = Settings(**{"server": "", **{key: _parsed(item) for key, item in given.items()}})
    if settings.mac is not None:
        _check_mac(given["mac"], settings)
    return settings


def shown(settings: Settings) -> list[str]:
    """Return one line "key = value" for each setting in force, secrets masked."""
    return [
        f"{item.name} = {_shown(item.name, getattr(settings, item.name))}"
        for item in fields(settings)
    ]


def _from_file(path: Path, *, must_exist: bool) -> dict[str, _Given]:
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        if not must_exist:
            return {}
        raise SettingsInvalid(f"cannot read the settings {path}: there is no such file") from error
    except PermissionError as error:
        raise SettingsInvalid(
            f"cannot read the settings {path}: permission denied",
            advice="run this with sudo, or let the agent's user read the file",
        ) from error
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise SettingsInvalid(f"cannot read the settings {path}: {error}") from error
    for key in table:
        if key not in PARSERS:
            raise _unknown(f"the key {key!r} in {path}", ", ".join(PARSERS))
    return {key: _Given(key, value, f"{path}: {key}") for key, value in table.items()}


def _from_environment(environ: Mapping[str, str]) -> dict[str, _Given]:
    given = {}
    for name, value in environ.items():
        # Empty is not set: compose files can pass an optional variable on in no other way.
        if not name.startswith(PREFIX) or not value:
            continue
        key = name.removeprefix(PREFIX).lower()
        if key not in PARSERS:
            known = ", ".join(f"{PREFIX}{known.upper()}" for known in PARSERS)
            raise _unknown(f"the environment variable {name}", known)
        given[key] = _Given(key, value, name)
    return given


def _unknown(what: str, known: str) -> SettingsInvalid:
    return SettingsInvalid(f"cannot start: {what} is not known", advice=f"allowed are {known}")


def _refuse_both(given: Mapping[str, _Given]) -> None:
    for one, other in EXCLUSIVE:
        if one in given and other in given:
            raise SettingsInvalid(
                f"cannot use both {given[one].source} and {given[other].source}",
                advice="remove one of them",
            )


def _parsed(item: _Given) -> Any:
    try:
        return PARSERS[item.key](item.value)
    except parse.RefusedValueError as error:
        raise item.refuse(f"allowed is {error}") from error


def _check_mac(item: _Given, settings: Settings) -> None:
    try:
        normalise_mac(str(settings.mac), allow_local=settings.allow_local_mac)
    except MacError as error:
        raise item.refuse(f"{error}; allowed with allow_local_mac = true") from error


def _shown(key: str, value: object) -> str:
    if value is None:
        return "(not set)"
    if key in SECRETS:
        return "(hidden)"
    if key in URLS_WITH_LOGIN:
        urls = value if isinstance(value, tuple) else (value,)
        return ", ".join(parse.without_login(str(url)) for url in urls)
    if isinstance(value, bytes):
        return value.hex(":")
    if isinstance(value, bool):
        return str(value).lower()
    return ", ".join(map(str, value)) if isinstance(value, tuple) else str(value)
