"""The agent's settings: agent.toml and ROBOTETHER_<KEY> of the environment, read once by the cli.

Everything else gets the frozen Settings as an argument. A wrong value stops the start and names the file
or variable, the key, the value and what is allowed. Secrets never reach a log or `show-settings`. A parser makes a
checked value of a TOML value or of a text from the environment; it raises RefusedValueError and nothing else.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from functools import partial
from ipaddress import IPv6Address
from pathlib import Path
from typing import Any
from urllib.parse import SplitResult, urlsplit

from robotether_agent.fields import HOST, IPV6, MAX_PORTS, ROBOT_NAME, MacError, normalise_mac
from robotether_agent.problems import DetailError, SettingsInvalidError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

DEFAULT_FILE = Path("/etc/robotether/agent.toml")
HTTPS = 443
PREFIX = "ROBOTETHER_"
SECRETS = frozenset({"token"})
# These URLs may contain a password.
URLS_WITH_LOGIN = frozenset({"http_proxy", "cameras"})
EXCLUSIVE = (("tls_fingerprint", "ca_file"), ("token", "token_file"), ("interface", "mac"))

PROXY_LOGIN = re.compile(r"[A-Za-z0-9._~!$&'()*+,;=%-]+:[A-Za-z0-9._~!$&'()*+,;=:%-]*")
INTERFACE = re.compile(r"(?!\.{1,2}\Z)[A-Za-z0-9._-]{1,15}")
# OpenSSH expands % and ${} in its file options and splits some at blanks.
PLAIN_PATH = re.compile(r"/[A-Za-z0-9._/+@:,=-]*")
# Maximum length of the run directory: a Unix socket's path has at most 107 bytes, and OpenSSH adds
# 17 to the control socket's while it binds.
MAX_RUN_DIR_LENGTH = 107 - 17 - len("/session.ctl")
MAX_PORT = 65535
PORT = re.compile(r"[0-9]{1,5}")
CAMERA_NAME = re.compile(r"[A-Za-z0-9_/][A-Za-z0-9_./-]{0,63}")
MAX_CAMERAS = 8
DEVICE = re.compile(r"/dev/video[0-9]{1,3}")


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
    video_encoder: str = "auto"
    # NAME=URL each; a URL may contain a password.
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

    @property
    def camera_urls(self) -> dict[str, str]:
        """The URLs of `cameras` by name."""
        return {name: url for name, _, url in (item.partition("=") for item in self.cameras)}


class RefusedValueError(DetailError, ValueError):
    """The value is not allowed; the message says what is."""


def _text(value: object) -> str:
    if not isinstance(value, str) or not value.strip():
        raise RefusedValueError("a text that is not empty")
    return value.strip()


def _one_of(names: tuple[str, ...], value: object) -> str:
    name = _text(value).lower()
    if name not in names:
        raise RefusedValueError(", ".join(f'"{name}"' for name in names))
    return name


def _matching(pattern: re.Pattern[str], allowed: str, value: object) -> str:
    text = _text(value)
    if not pattern.fullmatch(text):
        raise RefusedValueError(allowed)
    return text


def _host(value: object) -> str:
    name = _text(value)
    if not (HOST.fullmatch(name) or _is_ipv6(name)):
        raise RefusedValueError("a host name or an address")
    return name


def _is_ipv6(name: str) -> bool:
    """Distinguish an IPv6 address from a HOST:PORT of the same characters, such as 10.0.0.5:2222."""
    try:
        IPv6Address(name)
    except ValueError:
        return False
    return IPV6.fullmatch(name) is not None


def _split(url: str, allowed: str) -> SplitResult:
    """Return a URL's parts, whose port is none or from 1 to 65535; else say what is `allowed`."""
    try:
        split = urlsplit(url)
        # Python's resolver raises no OSError for a name with an empty or too long part.
        (split.hostname or "").encode("idna")
        if split.port != 0:
            return split
    except ValueError as error:
        raise RefusedValueError(allowed) from error
    raise RefusedValueError(allowed)


def _bracketed(name: str) -> str:
    """Return a host as it is written in a URL."""
    return f"[{name}]" if ":" in name else name


def _server(value: object) -> str:
    """Return HOST or HOST:PORT, with an IPv6 address in brackets."""
    name = _text(value)
    allowed = "HOST or HOST:PORT (of https), without https:// and path"
    split = _split(f"//{name}", allowed)
    bare = _bracketed(split.hostname or "")
    if name.lower() not in {bare, f"{bare}:{split.port}"}:
        raise RefusedValueError(allowed)
    _host(split.hostname)
    return name


def _fingerprint(value: object) -> bytes:
    """Return the 32 bytes of a SHA-256 in hexadecimal, with or without colons."""
    digits = _text(value).removeprefix("sha256:").replace(":", "")
    if not re.fullmatch(r"[0-9A-Fa-f]{64}", digits):
        raise RefusedValueError("the SHA-256 of the server's certificate: 64 hexadecimal digits")
    return bytes.fromhex(digits)


def _port(value: object) -> int:
    number = int(value) if isinstance(value, str) and PORT.fullmatch(value.strip()) else value
    if isinstance(number, bool) or not isinstance(number, int) or not 1 <= number <= MAX_PORT:
        raise RefusedValueError("a port from 1 to 65535")
    return number


def _ports(value: object) -> tuple[int, ...]:
    """Return one or more TCP ports, in the order in which they are tried."""
    items = value.split(",") if isinstance(value, str) else value
    if not isinstance(items, list) or not 1 <= len(items) <= MAX_PORTS:
        raise RefusedValueError("1 to 8 ports, such as [2222, 443] (in the environment: 2222,443)")
    return tuple(_port(item) for item in items)


def _flag(value: object) -> bool:
    values = {"true": True, "1": True, "yes": True, "false": False, "0": False, "no": False}
    if isinstance(value, bool):
        return value
    if isinstance(value, str) and value.strip().lower() in values:
        return values[value.strip().lower()]
    raise RefusedValueError("true or false")


def _mac(value: object) -> str:
    """Return a MAC address; whether a local one is allowed is another setting's matter."""
    try:
        return normalise_mac(_text(value), allow_local=True)
    except MacError as error:
        raise RefusedValueError(f"the MAC address of one interface ({error})") from error


def _shell_address(value: object) -> str:
    """Return HOST:PORT of the robot's own sshd, or nothing for no shell."""
    # An environment variable that is empty counts as not set.
    if value in ("", "none"):
        return ""
    allowed = 'HOST:PORT of an SSH server, such as 127.0.0.1:22, or "" or "none" for no shell'
    split = _split(f"//{_text(value)}", allowed)
    if split.path or split.query or split.fragment or not split.hostname or not split.port:
        raise RefusedValueError(allowed)
    return f"{_bracketed(_host(split.hostname))}:{split.port}"


def _service_url(scheme: str, default_port: int, value: object) -> str:
    """Return the URL of a service of the robot's, with its port and without a path."""
    allowed = f"{scheme}://HOST:PORT without a path, such as {scheme}://127.0.0.1:{default_port}"
    split = _split(_text(value), allowed)
    if split.scheme != scheme or not split.hostname or not _is_bare(split) or "@" in split.netloc:
        raise RefusedValueError(allowed)
    return f"{scheme}://{_bracketed(_host(split.hostname))}:{split.port or default_port}"


def _is_bare(split: SplitResult) -> bool:
    return split.path in {"", "/"} and not (split.query or split.fragment)


def _cameras(value: object) -> tuple[str, ...]:
    """Return NAME=URL for each camera that ROS does not know; the URL may contain a login, or be a device."""
    items = value.split() if isinstance(value, str) else value
    allowed = (
        f"up to {MAX_CAMERAS} NAME=URL of cameras with different names: http:// or https:// of MJPEG, rtsp://,"
        " or a device /dev/videoN,"
        ' such as ["rear=http://10.0.0.7/video"] (in the environment with blanks between them)'
    )
    if not isinstance(items, list) or not all(isinstance(item, str) for item in items):
        raise RefusedValueError(allowed)
    names = {item.partition("=")[0] for item in items}
    if not len(items) == len(names) <= MAX_CAMERAS:
        raise RefusedValueError(allowed)
    for item in items:
        _check_camera(item, allowed)
    return tuple(items)


def _check_camera(item: str, allowed: str) -> None:
    name, _, url = item.partition("=")
    split = _split(url, allowed)
    is_plain = url.isascii() and url.isprintable() and " " not in url
    is_url = split.scheme in {"http", "https", "rtsp"} and bool(split.hostname)
    if not (CAMERA_NAME.fullmatch(name) and is_plain and (is_url or DEVICE.fullmatch(url))):
        raise RefusedValueError(allowed)


def _http_proxy(value: object) -> str:
    """Return http://[USER:PASSWORD@]HOST:PORT of a proxy; the name and password stay as they are in a URL."""
    allowed = "http://HOST:PORT or http://USER:PASSWORD@HOST:PORT, with %40 and the like for signs"
    split = _split(_text(value), allowed)
    if split.scheme != "http" or not split.hostname or not _is_bare(split) or not split.port:
        raise RefusedValueError(allowed)
    login, at, _ = split.netloc.rpartition("@")
    if at and not PROXY_LOGIN.fullmatch(login):
        raise RefusedValueError(allowed)
    return f"http://{login}{at}{_bracketed(_host(split.hostname))}:{split.port}"


def _on_off(value: object) -> str:
    # YAML makes true and false of the bare words.
    word = {True: "on", False: "off"}[value] if isinstance(value, bool) else value
    return _one_of(("on", "off"), word)


def _path(value: object) -> Path:
    """Return an absolute path that needs no quoting."""
    return Path(_matching(PLAIN_PATH, "an absolute path of letters, digits and ._/+@:,=-", value))


def _run_dir(value: object) -> Path:
    """Return an absolute path that is short enough for the control sockets in it."""
    name = _path(value)
    if len(str(name)) > MAX_RUN_DIR_LENGTH:
        raise RefusedValueError(f"an absolute path of at most {MAX_RUN_DIR_LENGTH} characters")
    return name


def _without_login(url: str) -> str:
    """Return a URL for people to see: without the password in it."""
    scheme, _, rest = url.partition("://")
    login, at, address = rest.rpartition("@")
    return f"{scheme}://(hidden)@{address}" if at and login else url


PARSERS: dict[str, Callable[[object], Any]] = {
    "server": _server,
    "tls_fingerprint": _fingerprint,
    "ca_file": _path,
    "ssh_host": _host,
    "ssh_ports": _ports,
    "http_proxy": _http_proxy,
    "interface": partial(_matching, INTERFACE, "the name of a network interface, such as eth0"),
    "mac": _mac,
    # Whether it is free is the server's to say.
    "name": partial(
        _matching, ROBOT_NAME, "letters, digits and ._- (1 to 63, the first a letter or digit)"
    ),
    "allow_local_mac": _flag,
    "rosbridge_url": partial(_service_url, "ws", 9090),
    "video_url": partial(_service_url, "http", 8080),
    "video_source": partial(_one_of, ("auto", "web_video_server", "rosbridge")),
    "video_encoder": partial(_one_of, ("auto", "off")),
    "cameras": _cameras,
    "shell_address": _shell_address,
    "guard": _on_off,
    "state_dir": _path,
    "run_dir": _run_dir,
    "token": _text,
    "token_file": _path,
    "log_level": partial(_one_of, ("debug", "info", "warning", "error")),
}


@dataclass(frozen=True)
class _Value:
    """One value as it was given, and where."""

    key: str
    value: object
    source: str

    def refuse(self, why: str) -> SettingsInvalidError:
        hidden = self.key in SECRETS | URLS_WITH_LOGIN
        # Any URL may contain a password, and in most of them it is what is refused.
        value = _without_login(self.value) if isinstance(self.value, str) else self.value
        text = "(hidden)" if hidden else repr(value)
        return SettingsInvalidError(
            f"cannot use {self.source} = {text}: {why}", advice="correct it"
        )


def load(file: Path | None, environ: Mapping[str, str], *, needs_server: bool = True) -> Settings:
    """Return the settings from `file` (None: the usual one, if it is there) and `environ`.

    Without `needs_server` the server may be missing, and is then the empty text.
    """
    source = DEFAULT_FILE if file is None else file
    values = _from_file(source, must_exist=file is not None)
    values.update(_from_environment(environ))
    if "server" not in values and needs_server:
        raise SettingsInvalidError(
            f"cannot start: server is set neither in {source} nor as {PREFIX}SERVER",
            advice="set it to the server's host name or address, or HOST:PORT",
        )
    _refuse_both(values)
    settings = Settings(**{"server": "", **{key: _parsed(item) for key, item in values.items()}})
    if settings.mac is not None:
        _check_mac(values["mac"], settings)
    return settings


def settings_lines(settings: Settings) -> list[str]:
    """Return one line "key = value" for each setting in force, secrets masked."""
    return [
        f"{item.name} = {_masked(item.name, getattr(settings, item.name))}"
        for item in fields(settings)
    ]


def _from_file(path: Path, *, must_exist: bool) -> dict[str, _Value]:
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        if not must_exist:
            return {}
        raise SettingsInvalidError(
            f"cannot read the settings {path}: there is no such file"
        ) from error
    except PermissionError as error:
        raise SettingsInvalidError(
            f"cannot read the settings {path}: permission denied",
            advice="run this with sudo, or let the agent's user read the file",
        ) from error
    except OSError as error:
        raise SettingsInvalidError(f"cannot read the settings {path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise SettingsInvalidError(f"cannot read the settings {path}: it is not text") from error
    except tomllib.TOMLDecodeError as error:
        # Its text names line and column.
        raise SettingsInvalidError(f"cannot read the settings {path}: {error}") from error
    for key in table:
        if key not in PARSERS:
            raise _unknown(f"the key {key!r} in {path}", ", ".join(PARSERS))
    return {key: _Value(key, value, f"{path}: {key}") for key, value in table.items()}


def _from_environment(environ: Mapping[str, str]) -> dict[str, _Value]:
    values = {}
    for name, value in environ.items():
        # Empty is not set: compose files can pass an optional variable on in no other way.
        if not name.startswith(PREFIX) or not value:
            continue
        key = name.removeprefix(PREFIX).lower()
        if key not in PARSERS:
            variables = ", ".join(f"{PREFIX}{key.upper()}" for key in PARSERS)
            raise _unknown(f"the environment variable {name}", variables)
        values[key] = _Value(key, value, name)
    return values


def _unknown(what: str, names: str) -> SettingsInvalidError:
    return SettingsInvalidError(f"cannot start: {what} is not known", advice=f"allowed are {names}")


def _refuse_both(values: Mapping[str, _Value]) -> None:
    for key, other in EXCLUSIVE:
        if key in values and other in values:
            raise SettingsInvalidError(
                f"cannot use both {values[key].source} and {values[other].source}",
                advice="remove one of them",
            )


def _parsed(item: _Value) -> Any:
    try:
        return PARSERS[item.key](item.value)
    except RefusedValueError as error:
        raise item.refuse(f"allowed is {error}") from error


def _check_mac(item: _Value, settings: Settings) -> None:
    try:
        normalise_mac(str(settings.mac), allow_local=settings.allow_local_mac)
    except MacError as error:
        raise item.refuse(f"{error}; allowed with allow_local_mac = true") from error


def _masked(key: str, value: object) -> str:
    if value is None:
        return "(not set)"
    if key in SECRETS:
        return "(hidden)"
    if key in URLS_WITH_LOGIN:
        urls = value if isinstance(value, tuple) else (value,)
        return ", ".join(_without_login(str(url)) for url in urls)
    if isinstance(value, bytes):
        return value.hex(":")
    if isinstance(value, bool):
        return str(value).lower()
    return ", ".join(map(str, value)) if isinstance(value, tuple) else str(value)
