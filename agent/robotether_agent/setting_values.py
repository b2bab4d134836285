"""The parsers of single settings: from a TOML value or an environment text to a checked value.

Used by `settings`. Each raises RefusedValueError with what is allowed, and nothing else.
"""

from __future__ import annotations

import re
from ipaddress import IPv6Address
from pathlib import Path
from urllib.parse import urlsplit

from robotether_agent.fields import HOST, IPV6, ROBOT_NAME, MacError, normalise_mac

PROXY_LOGIN = re.compile(r"[A-Za-z0-9._~!$&'()*+,;=%-]+:[A-Za-z0-9._~!$&'()*+,;=:%-]*")
INTERFACE = re.compile(r"[A-Za-z0-9._-]{1,15}")
# OpenSSH expands % and ${} in its file options and splits some at blanks.
PLAIN_PATH = re.compile(r"/[A-Za-z0-9._/+@:,=-]*")
# A Unix socket's path has at most 107 bytes, and OpenSSH adds 17 to the control socket's while it binds.
MAX_RUN_DIR_LENGTH = 107 - 17 - len("/session.ctl")
MAX_PORT = 65535
MAX_PORTS = 8
PORT = re.compile(r"[0-9]{1,5}")
ON_OFF = ("on", "off")
VIDEO_SOURCES = ("auto", "web_video_server", "rosbridge")
CAMERA_NAME = re.compile(r"[A-Za-z0-9_/][A-Za-z0-9_./-]{0,63}")
MAX_CAMERAS = 8
LOG_LEVELS = ("debug", "info", "warning", "error")


class RefusedValueError(ValueError):
    """The value is not allowed; the message says what is."""


def text(value: object) -> str:
    """Return a non-empty text."""
    if not isinstance(value, str) or not value.strip():
        raise RefusedValueError("a text that is not empty")
    return value.strip()


def host(value: object) -> str:
    """Return a host name or address."""
    name = text(value)
    if not (HOST.fullmatch(name) or _is_ipv6(name)):
        raise RefusedValueError("a host name or an address")
    return name


def server(value: object) -> str:
    """Return HOST or HOST:PORT, with an IPv6 address in brackets."""
    name = text(value)
    allowed = "HOST or HOST:PORT (of https), without https:// and path"
    try:
        split = urlsplit(f"//{name}")
        number = split.port
    except ValueError as error:
        raise RefusedValueError(allowed) from error
    bare = _bracketed(split.hostname or "")
    if name.lower() not in {bare, f"{bare}:{number}"} or number == 0:
        raise RefusedValueError(allowed)
    host(split.hostname)
    return name


def fingerprint(value: object) -> bytes:
    """Return the 32 bytes of a SHA-256 in hexadecimal, with or without colons."""
    digits = text(value).removeprefix("sha256:").replace(":", "")
    if not re.fullmatch(r"[0-9A-Fa-f]{64}", digits):
        raise RefusedValueError("the SHA-256 of the server's certificate: 64 hexadecimal digits")
    return bytes.fromhex(digits)


def port(value: object) -> int:
    """Return a TCP port."""
    number = int(value) if isinstance(value, str) and PORT.fullmatch(value.strip()) else value
    if isinstance(number, bool) or not isinstance(number, int) or not 1 <= number <= MAX_PORT:
        raise RefusedValueError("a port from 1 to 65535")
    return number


def ports(value: object) -> tuple[int, ...]:
    """Return one or more TCP ports, in the order in which they are tried."""
    items = value.split(",") if isinstance(value, str) else value
    if not isinstance(items, list) or not 1 <= len(items) <= MAX_PORTS:
        raise RefusedValueError("1 to 8 ports, such as [2222, 443] (in the environment: 2222,443)")
    return tuple(port(item) for item in items)


def flag(value: object) -> bool:
    """Return true or false."""
    known = {"true": True, "1": True, "yes": True, "false": False, "0": False, "no": False}
    if isinstance(value, bool):
        return value
    if isinstance(value, str) and value.strip().lower() in known:
        return known[value.strip().lower()]
    raise RefusedValueError("true or false")


def mac(value: object) -> str:
    """Return a MAC address; whether a local one is allowed is another setting's matter."""
    try:
        return normalise_mac(text(value), allow_local=True)
    except MacError as error:
        raise RefusedValueError(f"the MAC address of one interface ({error})") from error


def robot_name(value: object) -> str:
    """Return a robot's name; whether it is free is the server's to say."""
    name = text(value)
    if not ROBOT_NAME.fullmatch(name):
        raise RefusedValueError("letters, digits and ._- (1 to 63, the first a letter or digit)")
    return name


def shell_address(value: object) -> str:
    """Return HOST:PORT of the robot's own sshd, or nothing for no shell."""
    # An environment variable that is empty counts as not set.
    if value in ("", "none"):
        return ""
    allowed = 'HOST:PORT of an SSH server, such as 127.0.0.1:22, or "" or "none" for no shell'
    try:
        split = urlsplit(f"//{text(value)}")
        number = split.port
    except ValueError as error:
        raise RefusedValueError(allowed) from error
    if split.path or split.query or split.fragment or not split.hostname or not number:
        raise RefusedValueError(allowed)
    return f"{_bracketed(host(split.hostname))}:{number}"


def interface(value: object) -> str:
    """Return the name of a network interface."""
    name = text(value)
    if not INTERFACE.fullmatch(name) or name in {".", ".."}:
        raise RefusedValueError("the name of a network interface, such as eth0")
    return name


def rosbridge_url(value: object) -> str:
    """Return a ws:// URL without a path."""
    return _local_url(value, "ws", 9090)


def video_url(value: object) -> str:
    """Return an http:// URL without a path."""
    return _local_url(value, "http", 8080)


def video_source(value: object) -> str:
    """Return where pictures come from."""
    name = text(value)
    if name not in VIDEO_SOURCES:
        raise RefusedValueError(", ".join(f'"{known}"' for known in VIDEO_SOURCES))
    return name


def cameras(value: object) -> tuple[str, ...]:
    """Return NAME=URL for each camera that ROS does not know; a login may stand in the URL."""
    items = value.split() if isinstance(value, str) else value
    allowed = (
        f"up to {MAX_CAMERAS} NAME=URL of MJPEG cameras, with http:// or https:// and different names,"
        ' such as ["rear=http://10.0.0.7/video"] (in the environment with blanks between them)'
    )
    if not isinstance(items, list) or not all(isinstance(item, str) for item in items):
        raise RefusedValueError(allowed)
    names = [item.partition("=")[0] for item in items]
    if len(items) > MAX_CAMERAS or len(set(names)) < len(names):
        raise RefusedValueError(allowed)
    if not all(_is_camera(item) for item in items):
        raise RefusedValueError(allowed)
    return tuple(items)


def camera_urls(given: tuple[str, ...]) -> dict[str, str]:
    """Return the URLs of checked cameras by name."""
    return {name: url for name, _, url in (item.partition("=") for item in given)}


def _is_camera(item: str) -> bool:
    name, _, url = item.partition("=")
    try:
        split = urlsplit(url)
        port_fits = split.port != 0
    except ValueError:
        return False
    is_plain = url.isascii() and url.isprintable() and " " not in url
    is_http = split.scheme in {"http", "https"} and bool(split.hostname)
    return bool(CAMERA_NAME.fullmatch(name)) and is_plain and is_http and port_fits


def http_proxy(value: object) -> str:
    """Return http://[USER:PASSWORD@]HOST:PORT of a proxy; the name and password stay as they are in a URL."""
    allowed = "http://HOST:PORT or http://USER:PASSWORD@HOST:PORT, with %40 and the like for signs"
    name = text(value)
    try:
        split = urlsplit(name)
        number = split.port
    except ValueError as error:
        raise RefusedValueError(allowed) from error
    bare = split.path in {"", "/"} and not (split.query or split.fragment)
    if split.scheme != "http" or not split.hostname or not bare or not number:
        raise RefusedValueError(allowed)
    login, at, _ = split.netloc.rpartition("@")
    if at and not PROXY_LOGIN.fullmatch(login):
        raise RefusedValueError(allowed)
    return f"http://{login}{at}{_bracketed(host(split.hostname))}:{number}"


def without_login(url: str) -> str:
    """Return a URL for people to see: without the password in it."""
    scheme, _, rest = url.partition("://")
    login, at, address = rest.rpartition("@")
    return f"{scheme}://(hidden)@{address}" if at and login else url


def on_off(value: object) -> str:
    """Return "on" or "off", also for true and false, which YAML makes of the bare words."""
    if isinstance(value, bool):
        return "on" if value else "off"
    name = text(value).lower()
    if name not in ON_OFF:
        raise RefusedValueError('"on" or "off"')
    return name


def path(value: object) -> Path:
    """Return an absolute path that needs no quoting."""
    name = text(value)
    if not PLAIN_PATH.fullmatch(name):
        raise RefusedValueError("an absolute path of letters, digits and ._/+@:,=-")
    return Path(name)


def run_dir(value: object) -> Path:
    """Return an absolute path that is short enough for the control sockets in it."""
    name = path(value)
    if len(str(name)) > MAX_RUN_DIR_LENGTH:
        raise RefusedValueError(f"an absolute path of at most {MAX_RUN_DIR_LENGTH} characters")
    return name


def log_level(value: object) -> str:
    """Return one of the log levels."""
    name = text(value).lower()
    if name not in LOG_LEVELS:
        raise RefusedValueError(", ".join(LOG_LEVELS))
    return name


def _local_url(value: object, scheme: str, default_port: int) -> str:
    example = f"{scheme}://HOST:PORT without a path, such as {scheme}://127.0.0.1:{default_port}"
    try:
        split = urlsplit(text(value))
        number = default_port if split.port is None else split.port
    except ValueError as error:
        raise RefusedValueError(example) from error
    bare = split.path in {"", "/"} and not (split.query or split.fragment or "@" in split.netloc)
    if split.scheme != scheme or not split.hostname or not bare or number == 0:
        raise RefusedValueError(example)
    return f"{scheme}://{_bracketed(host(split.hostname))}:{number}"


def _bracketed(name: str) -> str:
    """Return a host as it stands in a URL."""
    return f"[{name}]" if ":" in name else name


def _is_ipv6(name: str) -> bool:
    """Tell an IPv6 address from a HOST:PORT of the same characters, such as 10.0.0.5:2222."""
    try:
        IPv6Address(name)
    except ValueError:
        return False
    return IPV6.fullmatch(name) is not None
