"""CONNECT through the HTTP proxy of a closed network (setting http_proxy).

Used by the dialler; the join gives the same proxy to its HTTP client. The password never reaches a log or message.
"""

from __future__ import annotations

import asyncio
import re
import socket
from base64 import b64encode
from dataclasses import dataclass, field
from http import HTTPStatus
from urllib.parse import unquote, urlsplit

from robotether_agent.fields import printable
from robotether_agent.net.tcp import peek
from robotether_agent.problems import AgentError, NoAnswerError, ServerUnreachableError
from robotether_agent.tasks import within

DEFAULT_PORT = 3128
# Time limit for the proxy's answer, which it gives once it has reached the server or failed.
TIMEOUT_S = 5.0
MAX_ANSWER_BYTES = 8 * 1024
END = b"\r\n\r\n"
DEAD_ADVICE = "see that the HTTP proxy runs, and check the setting http_proxy"
ADVICE = "check the setting http_proxy, and that the proxy lets CONNECT out to the server's ports"
LOGIN_ADVICE = (
    "put the user and password that the proxy wants into http_proxy: http://USER:PASSWORD@HOST:PORT"
)
GATEWAY_ADVICE = (
    "see that the server runs, and that the proxy's own network and name service lead to it"
)
GATEWAY_FAILURES = frozenset(
    {HTTPStatus.BAD_GATEWAY, HTTPStatus.SERVICE_UNAVAILABLE, HTTPStatus.GATEWAY_TIMEOUT}
)
STATUS_LINE = re.compile(rb"HTTP/1\.[01] ([1-5][0-9]{2})(?: ([^\r\n]*))?\r?\n")


@dataclass(frozen=True)
class Proxy:
    """Where the proxy is, and who asks."""

    host: str
    port: int
    user: str = field(default="", repr=False)
    password: str = field(default="", repr=False)

    @property
    def address(self) -> tuple[str, int]:
        """Its host and port."""
        return self.host, self.port

    def __str__(self) -> str:
        return f"the HTTP proxy {self.host} port {self.port}"


def proxy_of(url: str | None) -> Proxy | None:
    """Return the proxy that a checked URL "http://[user:password@]host:port" names."""
    if not url:
        return None
    split = urlsplit(url)
    if split.hostname is None:
        raise ValueError("the URL of the HTTP proxy has no host")
    user, password = unquote(split.username or ""), unquote(split.password or "")
    return Proxy(split.hostname, split.port or DEFAULT_PORT, user, password)


async def ask_for(
    connection: socket.socket, proxy: Proxy, host: str, port: int, *, what: str = "SSH"
) -> None:
    """Make the proxy join `connection` to `host`; raise a problem that has its answer and names `what`."""
    where = f"{what} at {host} port {port}"
    try:
        # A request fits into the empty buffer of a connection that is new.
        connection.send(request(proxy, host, port))
        head = await within(TIMEOUT_S, peek(connection, lambda seen: END in seen, MAX_ANSWER_BYTES))
    except asyncio.TimeoutError as error:
        why = f"{proxy} does not answer in {TIMEOUT_S:g} s"
        raise NoAnswerError(f"cannot reach {where}: {why}", advice=DEAD_ADVICE) from error
    except OSError as error:
        why = f"{proxy} closes the connection"
        raise ServerUnreachableError(f"cannot reach {where}: {why}", advice=ADVICE) from error
    problem = refusal(head, proxy, where)
    if problem is not None:
        raise problem
    # Exactly the proxy's answer: what follows is the server's.
    connection.recv(head.index(END) + len(END))


def request(proxy: Proxy, host: str, port: int) -> bytes:
    """Return the words that ask for a connection."""
    authority = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
    lines = [f"CONNECT {authority} HTTP/1.1", f"Host: {authority}"]
    if proxy.user or proxy.password:
        secret = b64encode(f"{proxy.user}:{proxy.password}".encode()).decode()
        lines.append(f"Proxy-Authorization: Basic {secret}")
    return "\r\n".join([*lines, "", ""]).encode()


def refusal(head: bytes, proxy: Proxy, where: str) -> AgentError | None:
    """Return what an answer means, or None when the connection is up."""
    line = STATUS_LINE.match(head)
    if line is None or END not in head:
        why = f"{proxy} answers with what is not HTTP"
        return ServerUnreachableError(f"cannot reach {where}: {why}", advice=ADVICE)
    status = int(line[1])
    if HTTPStatus.OK <= status < HTTPStatus.MULTIPLE_CHOICES:
        return None
    reason = printable((line[2] or b"").decode("latin-1"), 80)
    why = f"{proxy} answers {status} {reason}".rstrip()
    if status in GATEWAY_FAILURES:
        why = f"{why}: it cannot reach that itself"
    kind = NoAnswerError if status == HTTPStatus.GATEWAY_TIMEOUT else ServerUnreachableError
    return kind(f"cannot reach {where}: {why}", advice=advice_on(status))


def advice_on(status: int) -> str:
    """Return what to do about a proxy that answers so."""
    if status in GATEWAY_FAILURES:
        return GATEWAY_ADVICE
    return LOGIN_ADVICE if status == HTTPStatus.PROXY_AUTHENTICATION_REQUIRED else ADVICE
