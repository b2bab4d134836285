"""Checks the server from here: its name, port, certificate and clock, and whether it is a Robotether server.

view_server() asks the network once; the checks are pure functions of what it saw.
"""

from __future__ import annotations

import asyncio
import hashlib
import socket
import ssl
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime, timedelta, timezone
from email.utils import parsedate_to_datetime
from typing import Any

import aiohttp

from robotether_agent.describe_error import (
    CLOCK_ADVICE,
    MITM_ADVICE,
    NAME_ADVICE,
    NO_CAUSE,
    SILENT_ADVICE,
    Cause,
    cause_of,
)
from robotether_agent.doctor import OK, Finding, fail, ok, skipped
from robotether_agent.enrolment.join import REDIRECTS, SshAccess, parse_ssh
from robotether_agent.fields import FieldError, get_object, get_text, parse_object, printable
from robotether_agent.net.http_proxy import DEAD_ADVICE, Proxy, ask_for, proxy_of
from robotether_agent.net.tcp import CHECK_NETWORK, CHECK_SERVER, Resolver, connect
from robotether_agent.problems import AgentError
from robotether_agent.settings import Settings
from robotether_agent.tasks import within

TIMEOUT_S = 6.0
MAX_ANSWER_BYTES = 16 * 1024
# It answers to anybody, in words that no other server has.
SSH_PATH = "/api/v1/ssh"
CLOCK_TOLERANCE = timedelta(minutes=5)
BUILT = datetime(2025, 1, 1, tzinfo=timezone.utc)


@dataclass(frozen=True)
class ServerView:
    """What could be seen of the server; a cause is why not, and what comes after it was not asked."""

    host: str
    port: int
    # What the robot goes through, if anything.
    proxy: str = ""
    addresses: tuple[str, ...] = ()
    no_address: Cause = NO_CAUSE
    no_port: Cause = NO_CAUSE
    no_tls: Cause = NO_CAUSE
    certificate: bytes = b""
    distrust: Cause = NO_CAUSE
    no_answer: Cause = NO_CAUSE
    date: datetime | None = None
    status: int = 0
    location: str = ""
    code: str = ""
    # Where it says that robots connect.
    ssh: SshAccess | None = None

    @property
    def is_ours(self) -> bool:
        """Whether a Robotether server answered."""
        return bool(self.code) or self.ssh is not None


async def view_server(settings: Settings) -> ServerView:
    """Return how the server looks; sends nothing that is secret, and trusts nothing."""
    host, port = settings.server_host, settings.server_port
    proxy = proxy_of(settings.http_proxy)
    seen = ServerView(host, port, proxy="" if proxy is None else str(proxy))
    try:
        if proxy is None:
            seen = replace(seen, addresses=await within(TIMEOUT_S, _resolve(host, port)))
    except (OSError, asyncio.TimeoutError) as error:
        return replace(seen, no_address=cause_of(error, TIMEOUT_S))
    try:
        await within(TIMEOUT_S, _connect(settings, None))
    except (AgentError, OSError, asyncio.TimeoutError) as error:
        return replace(seen, no_port=_reason(error, CHECK_NETWORK))
    try:
        seen = replace(seen, certificate=await within(TIMEOUT_S, _connect(settings, _blind())))
    except (AgentError, OSError, ValueError, asyncio.TimeoutError) as error:
        return replace(seen, no_tls=_reason(error, SILENT_ADVICE))
    seen = replace(seen, distrust=await _distrust(settings))
    try:
        return await within(TIMEOUT_S, _ask(settings, seen))
    except (aiohttp.ClientError, OSError, ValueError, asyncio.TimeoutError) as error:
        return replace(seen, no_answer=cause_of(error, TIMEOUT_S))


def check_name(seen: ServerView) -> Finding:
    """Whether the server's name leads to an address."""
    if seen.proxy:
        return skipped("name", f"{seen.proxy} finds the address of {seen.host}")
    if seen.no_address:
        return fail(
            "name",
            f"cannot find the address of {seen.host}: {seen.no_address.sentence}",
            seen.no_address.advice or NAME_ADVICE,
        )
    return ok("name", f"{seen.host} is {', '.join(seen.addresses)}")


def check_port(seen: ServerView) -> Finding:
    """Whether the server's https port accepts."""
    if seen.no_address:
        return skipped("https port", "no address to ask")
    if seen.no_port and seen.proxy:
        return fail("https port", seen.no_port.sentence, seen.no_port.advice or DEAD_ADVICE)
    if seen.no_port:
        return fail(
            "https port",
            f"cannot reach {seen.host} port {seen.port}: {seen.no_port.sentence}",
            seen.no_port.advice or CHECK_SERVER,
        )
    through = f" through {seen.proxy}" if seen.proxy else ""
    return ok("https port", f"{seen.host} port {seen.port} accepts{through}")


def check_certificate(seen: ServerView, pinned: bytes | None) -> Finding:
    """Whether the certificate is the pinned one, or one that an authority vouches for."""
    if seen.no_address or seen.no_port:
        return skipped("certificate", "no connection")
    if seen.no_tls:
        why = f"{seen.host} port {seen.port} accepts, but there is no TLS: {seen.no_tls.sentence}"
        return fail("certificate", why, seen.no_tls.advice or MITM_ADVICE)
    fingerprint = hashlib.sha256(seen.certificate).hexdigest()
    if pinned is None:
        return _check_authority(seen, fingerprint)
    if fingerprint != pinned.hex():
        return fail(
            "certificate",
            f"the server shows {fingerprint}, and tls_fingerprint is {pinned.hex()}",
            "ask the server's administrator which one is right: correct tls_fingerprint, or find out who is in between",
        )
    return ok("certificate", f"it is the pinned one, {fingerprint}")


def check_clock(seen: ServerView, now: datetime, *, is_pinned: bool) -> Finding:
    """Whether this robot's clock agrees with the server's; an authority's certificate is checked by it, too."""
    advice = CLOCK_ADVICE + (
        "; with tls_fingerprint set the tunnel works all the same" if is_pinned else ""
    )
    says = f"this robot's clock says {_date_text(now)}"
    if seen.date is not None:
        if abs(now - seen.date) > CLOCK_TOLERANCE:
            return fail("clock", f"{says}, and the server's {_date_text(seen.date)}", advice)
        return ok("clock", f"{says}, as the server's")
    if now < BUILT:
        return fail("clock", f"{says}, which is before this program was built", advice)
    return ok("clock", f"{says}; there is nothing to compare it with")


def check_answer(seen: ServerView) -> Finding:
    """Whether it is a Robotether server that answers, and nothing in between."""
    step, portal = "answer", "log in to this network's portal in a browser, or use another network"
    if seen.no_address or seen.no_port or seen.no_tls:
        return skipped(step, "no connection")
    if seen.no_answer:
        reason = f"no answer from {seen.host}: {seen.no_answer.sentence}"
        return fail(step, reason, seen.no_answer.advice or "see the server's log")
    if seen.status in REDIRECTS:
        where = printable(seen.location, 100)
        return fail(step, f"a captive portal answers: it redirects to {where}", portal)
    if not seen.is_ours:
        reason = f"something answers with HTTP status {seen.status} that is not a Robotether server"
        return fail(step, reason, f"check the setting server; {portal}")
    return ok(step, f"a Robotether server answers at {seen.host}")


def _check_authority(seen: ServerView, fingerprint: str) -> Finding:
    if seen.distrust:
        return fail(
            "certificate",
            f"this robot does not trust {fingerprint}: {seen.distrust.sentence}",
            f"{seen.distrust.advice or 'set tls_fingerprint or ca_file'}; and see that the clock is right",
        )
    return ok("certificate", f"an authority has signed it ({fingerprint})")


async def _resolve(host: str, port: int) -> tuple[str, ...]:
    loop = asyncio.get_running_loop()
    infos = await loop.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    return tuple(dict.fromkeys(str(address[0]) for *_, address in infos))


async def _connect(settings: Settings, context: ssl.SSLContext | None) -> bytes:
    """Connect, through the proxy if there is one, and return the certificate that was shown, if this is TLS."""
    host, port = settings.server_host, settings.server_port
    name = None if context is None else host
    proxy = proxy_of(settings.http_proxy)
    where: dict[str, Any] = {"host": host, "port": port}
    if proxy is not None:
        where = {"sock": await _joined(proxy, host, port)}
    _, writer = await asyncio.open_connection(ssl=context, server_hostname=name, **where)
    try:
        session = writer.get_extra_info("ssl_object")
        return b"" if session is None else session.getpeercert(binary_form=True)
    finally:
        writer.transport.abort()


async def _joined(proxy: Proxy, host: str, port: int) -> socket.socket:
    connection = await connect(*proxy.address, Resolver(), str(proxy), DEAD_ADVICE)
    try:
        await ask_for(connection, proxy, host, port, what="https")
    except BaseException:
        connection.close()
        raise
    return connection


def _reason(error: BaseException, if_silent: str) -> Cause:
    """Return the cause in `error`; `if_silent` is the advice on no answer at all."""
    if isinstance(error, AgentError):
        return Cause(error.message, error.advice)
    cause = cause_of(error, TIMEOUT_S)
    is_silent = isinstance(error, asyncio.TimeoutError) and not cause.advice
    return replace(cause, advice=if_silent) if is_silent else cause


async def _distrust(settings: Settings) -> Cause:
    """Return why no authority vouches for the server, or nothing when one does or none is asked."""
    if settings.tls_fingerprint is not None:
        return NO_CAUSE
    try:
        context = ssl.create_default_context(cafile=settings.ca_file)
        await within(TIMEOUT_S, _connect(settings, context))
    except (AgentError, OSError, asyncio.TimeoutError) as error:
        return _reason(error, SILENT_ADVICE)
    return NO_CAUSE


async def _ask(settings: Settings, seen: ServerView) -> ServerView:
    url = f"https://{settings.server}{SSH_PATH}"
    async with (
        aiohttp.ClientSession() as http,
        http.get(url, ssl=_blind(), allow_redirects=False, proxy=settings.http_proxy) as response,
    ):
        body = await response.content.read(MAX_ANSWER_BYTES)
        return replace(
            seen,
            status=response.status,
            location=response.headers.get("Location", ""),
            date=_date(response.headers.get("Date", "")),
            code=_code(body),
            # An impostor's ports are nobody's.
            ssh=_ssh(body) if _is_trusted(settings, seen) else None,
        )


def _date(text: str) -> datetime | None:
    """Return an answer's date, in UTC where it names no zone, or nothing where it is none."""
    with suppress(ValueError, OverflowError):
        date = parsedate_to_datetime(text)
        return date if date.tzinfo else date.replace(tzinfo=timezone.utc)
    return None


def _code(body: bytes) -> str:
    try:
        return get_text(parse_object(body, "the answer"), "code")
    except FieldError:
        return ""


def _ssh(body: bytes) -> SshAccess | None:
    try:
        return parse_ssh(get_object(parse_object(body, "the answer"), "ssh"))
    except FieldError:
        return None


def _is_trusted(settings: Settings, seen: ServerView) -> bool:
    return check_certificate(seen, settings.tls_fingerprint).state == OK


def _blind() -> ssl.SSLContext:
    """Return a context that looks without trusting: what it sees is shown to a person, and nothing else."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    return context


def _date_text(time: datetime) -> str:
    return f"{time:%Y-%m-%d %H:%M:%S} UTC"
