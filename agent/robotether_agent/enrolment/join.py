"""Sends the join request, POST /api/v1/join, and reads the answer.

Called by the enroller. Trusts the pinned certificate, the given CA file or the system's CAs, and nothing
else; follows no redirect, so that a captive portal cannot answer in the server's place.
"""

from __future__ import annotations

import asyncio
import re
import ssl
from dataclasses import asdict, dataclass, fields
from datetime import datetime, timezone
from http import HTTPStatus

import aiohttp
from robotether_common.join import PreviousKey

from robotether_agent.describe_error import EXPIRED, NOT_YET_VALID, Cause, cause_of
from robotether_agent.enrolment import keys
from robotether_agent.enrolment.keys import HostKey
from robotether_agent.fields import (
    ADDRESS,
    MAX_RANK,
    ROBOT_NAME,
    FieldError,
    JsonObject,
    ListedCell,
    get_cells,
    get_match,
    get_object,
    get_ports,
    get_text,
    get_texts,
    parse_object,
    printable,
)
from robotether_agent.net.http_proxy import DEAD_ADVICE, advice_on, proxy_of
from robotether_agent.problems import (
    AgentError,
    AnswerInvalidError,
    JoinRefusedError,
    NotEnrolledError,
    Retry,
    ServerUnreachableError,
    SettingsInvalidError,
    TlsUntrustedError,
)
from robotether_agent.settings import Settings
from robotether_agent.tasks import within

TIMEOUT_S = 15.0
MAX_ANSWER_BYTES = 64 * 1024
REDIRECTS = range(300, 400)
CODE = re.compile(r"[a-z][a-z0-9_]{0,49}")
USER = re.compile(r"[a-z_][a-z0-9_-]{0,31}")

# Of the unit, and not of the same command that a person runs.
NOT_IN_HOME = " (not in /home or /root, which the boot service cannot read)"

ADVICE = {
    "token_invalid": "make a new join token on the server (robotether robot invite), or remove the token from "
    "the settings: the robot then waits for an approval",
    "token_expired": "make a new join token on the server (robotether robot invite), or remove the token from "
    "the settings: the robot then waits for an approval",
    "token_used_up": "make a join token with more uses on the server (robotether robot invite), or remove the "
    "token from the settings: the robot then waits for an approval",
    "token_required": "this server requires one: make a join token on the server (robotether "
    "robot invite), and set token_file",
    "robot_disabled": "enable the robot on the server's page",
    "key_rejected": "if that was a mistake, an admin can allow the key to ask again on the server's page; or give this "
    "robot another key with: sudo robotether-agent forget",
    "key_unproven": "if this agent is not older than the server, make this robot a new key with: sudo robotether-agent "
    "forget",
    "key_in_use": "another robot's row has this key: if this machine is a copy of that robot, make it one of its "
    "own with: sudo robotether-agent forget",
    "mac_elsewhere": "if this machine is a copy of that robot, make it one of its own with: sudo robotether-agent "
    "forget; if its network card was replaced, stop the other robot that has its key",
    "mac_in_use": "another robot's key holds this MAC: if this robot got a new disk, an admin approves the new key",
    "field_invalid": "correct the setting that this field comes from",
    "too_many_pending": "approve or remove the robots that wait on the server",
    "grant_missing": "the token's user must be an admin",
}
PENDING_ADVICE = {
    "mac_in_use": "if this robot got a new disk or a new key, an admin approves it after comparing the key; else "
    "give this robot another address with interface or mac in agent.toml",
}


@dataclass(frozen=True, kw_only=True)
class JoinRequest:
    """What the robot says about itself; `public_key` is one line `ssh-ed25519 AAAA...`."""

    mac: str
    public_key: str
    hostname: str
    agent_version: str
    mac_present: bool = True
    host_key_refused: bool = False
    token: str | None = None
    name: str | None = None
    signature: str | None = None
    previous_key: PreviousKey | None = None

    def body(self) -> dict[str, object]:
        """Return the JSON object of the request; what has its usual value is left out."""
        members = asdict(self)
        return {
            member.name: members[member.name]
            for member in fields(self)
            if members[member.name] != member.default
        }


@dataclass(frozen=True)
class SshAccess:
    """Where the tunnel goes; `host` None is the host that the join went to.

    `cells` are the server's machines, as it listed them last. The list is trusted because it comes with a join's
    answer, over the TLS that the settings pin, or on a line of the session, over SSH with a pinned host key. It opens
    nothing to anybody: whatever address it names, one pin holds for all of them (`keys.ALIAS`), so that each cell
    must show one of the pinned host keys before it gets a word of the session.
    """

    user: str
    host: str | None
    ports: tuple[int, ...]
    cells: tuple[ListedCell, ...] = ()

    def in_order(self, settings: Settings) -> list[ListedCell]:
        """Return the cells in the order in which they are tried; what an admin has set wins over any list.

        Last comes the address of the join: on this robot's network the names of a list may lead nowhere.
        """
        host = settings.ssh_host or self.host or settings.server_host
        listed = () if settings.ssh_host else self.cells
        return list(
            dict.fromkeys(
                ListedCell(cell.host, settings.ssh_ports or cell.ports, cell.rank)
                for cell in (*listed, ListedCell(host, self.ports, MAX_RANK))
            )
        )


@dataclass(frozen=True)
class Joined:
    """An active robot's answer."""

    robot: str
    ssh: SshAccess
    host_keys: list[HostKey]


def join_token(settings: Settings) -> str | None:
    """Return the join token, read when it is needed: an enrolled robot may have lost the file."""
    if settings.token_file is None:
        return settings.token
    try:
        return settings.token_file.read_text(encoding="ascii").strip() or None
    except (OSError, UnicodeDecodeError) as error:
        raise SettingsInvalidError(
            f"cannot read the join token in {settings.token_file}, which token_file names: "
            f"{cause_of(error, 0).sentence}",
            advice=f"put the token there{NOT_IN_HOME}, or remove token_file from the settings",
        ) from error


async def join(settings: Settings, request: JoinRequest) -> Joined:
    """Return the answer for an active robot; any other answer is raised as its problem."""
    try:
        status, body = await within(TIMEOUT_S, _post(settings, request))
    except aiohttp.ServerFingerprintMismatch as error:
        raise TlsUntrustedError(
            f"cannot trust {settings.server}: its certificate has the SHA-256 {error.got.hex(':')}, not the pinned one",
            advice="compare it with the one that the server printed and correct tls_fingerprint, or find out who is in "
            "between, such as a captive portal",
        ) from error
    except (aiohttp.ClientProxyConnectionError, aiohttp.ClientHttpProxyError) as error:
        raise _proxy_problem(settings, error) from error
    except aiohttp.ClientConnectorCertificateError as error:
        raise _untrusted(settings, error.certificate_error) from error
    except (aiohttp.ClientError, OSError, ValueError, asyncio.TimeoutError) as error:
        raise _unreachable(settings, cause_of(error, TIMEOUT_S)) from error
    return read_answer(settings.server, status, body)


def read_answer(server: str, status: int, body: bytes) -> Joined:
    """Return what an HTTP answer says, or raise the problem that it reports."""
    if status >= HTTPStatus.INTERNAL_SERVER_ERROR:
        raise ServerUnreachableError(f"cannot join {server}: it answers with HTTP status {status}")
    if status in REDIRECTS:
        raise AnswerInvalidError(
            f"cannot join {server}: something redirects (HTTP status {status}), which no Robotether server does",
            advice="log in to the captive portal of this network in a browser, or see that server names a Robotether "
            "server",
        )
    try:
        answer = parse_object(body, "the answer")
        if status == HTTPStatus.OK:
            return _joined(answer)
        code = get_match(answer, "code", CODE, "a short code")
        detail = get_text(answer, "detail")
    except FieldError as error:
        raise AnswerInvalidError(
            f"cannot join {server}: HTTP status {status}, and {error}",
            advice="see that server names a Robotether server, and that no captive portal is in between",
        ) from error
    raise _refusal(server, status, code, detail)


def _joined(answer: JsonObject) -> Joined:
    get_match(answer, "state", re.compile("active"), "active")
    ssh = get_object(answer, "ssh")
    robot = get_match(answer, "robot", ROBOT_NAME, "a robot's name")
    return Joined(robot, parse_ssh(ssh), parse_host_keys(ssh))


def parse_ssh(obj: JsonObject) -> SshAccess:
    """Return the member `ssh` of a join answer or of the kept file."""
    # These become arguments of the SSH client, so they must not look like options.
    host = None if obj.get("host") is None else get_match(obj, "host", ADDRESS, "a host name")
    user = get_match(obj, "user", USER, "a user name")
    return SshAccess(user, host, get_ports(obj, "ports"), get_cells(obj, "cells"))


def parse_host_keys(obj: JsonObject) -> list[HostKey]:
    """Return the list `host_keys` of a join answer."""
    return [keys.parse_host_key(text) for text in get_texts(obj, "host_keys")]


def _refusal(server: str, status: int, code: str, detail: str) -> AgentError:
    if status == HTTPStatus.ACCEPTED:
        advice = PENDING_ADVICE.get(code, "")
        return NotEnrolledError(f"cannot connect to {server} yet: {detail}", advice=advice)
    retry = Retry.ASK_AGAIN if status == HTTPStatus.TOO_MANY_REQUESTS else Retry.SLOWLY
    advice = ADVICE.get(code, "ask the server's administrator")
    return JoinRefusedError(
        f"cannot join {server}: {detail}", code=code, retry=retry, advice=advice
    )


async def _post(settings: Settings, request: JoinRequest) -> tuple[int, bytes]:
    url = f"https://{settings.server}/api/v1/join"
    async with (
        aiohttp.ClientSession() as http,
        http.post(
            url,
            json=request.body(),
            ssl=_trust(settings),
            allow_redirects=False,
            proxy=settings.http_proxy,
        ) as response,
    ):
        body = bytearray()
        async for chunk in response.content.iter_chunked(4096):
            body += chunk
            if len(body) > MAX_ANSWER_BYTES:
                raise FieldError(f"its answer is longer than {MAX_ANSWER_BYTES} bytes")
        return response.status, bytes(body)


def _trust(settings: Settings) -> aiohttp.Fingerprint | ssl.SSLContext:
    if settings.tls_fingerprint is not None:
        return aiohttp.Fingerprint(settings.tls_fingerprint)
    try:
        return ssl.create_default_context(cafile=settings.ca_file)
    except (OSError, ssl.SSLError) as error:
        raise SettingsInvalidError(
            f"cannot use ca_file = {str(settings.ca_file)!r}: {_why_no_ca(error)}",
            advice=f"allowed is a readable file of certificates in PEM{NOT_IN_HOME}",
            # The file may come back, and a robot that is connected needs it for a new key alone.
            retry=Retry.SLOWLY,
        ) from error


def _why_no_ca(error: OSError) -> str:
    if isinstance(error, ssl.SSLError):
        return "it holds no certificate in PEM"
    return cause_of(error, 0).sentence


def _untrusted(settings: Settings, error: Exception) -> TlsUntrustedError:
    now = f"{datetime.now(timezone.utc):%Y-%m-%d %H:%M} UTC"
    cause = cause_of(error, TIMEOUT_S)
    if getattr(error, "verify_code", None) in {NOT_YET_VALID, EXPIRED}:
        return TlsUntrustedError(
            f"cannot trust the certificate of {settings.server}: this robot's clock says {now}, and by that "
            f"{cause.sentence}",
            advice="this is tried again: a robot without a battery-backed clock waits for the time from the network "
            "(timedatectl set-ntp true); with tls_fingerprint set the clock does not matter",
        )
    return TlsUntrustedError(
        f"cannot trust the certificate of {settings.server}: {cause.sentence}",
        advice=f"{cause.advice or 'set tls_fingerprint or ca_file'}; and see that this robot's clock is right (it says "
        f"{now}), and that no captive portal is in between",
    )


def _proxy_problem(
    settings: Settings, error: aiohttp.ClientProxyConnectionError | aiohttp.ClientHttpProxyError
) -> ServerUnreachableError:
    """Return what the HTTP proxy answers, or that it does not."""
    proxy = proxy_of(settings.http_proxy)
    if isinstance(error, aiohttp.ClientHttpProxyError):
        why = f"{proxy} answers {error.status} {printable(error.message, 80)}".rstrip()
        return ServerUnreachableError(
            f"cannot reach https://{settings.server}: {why}", advice=advice_on(error.status)
        )
    cause = cause_of(error, TIMEOUT_S)
    return ServerUnreachableError(
        f"cannot reach https://{settings.server}: {proxy} cannot be reached: {cause.sentence}",
        advice=cause.advice or DEAD_ADVICE,
    )


def _unreachable(settings: Settings, cause: Cause) -> ServerUnreachableError:
    return ServerUnreachableError(
        f"cannot reach https://{settings.server}: {cause.sentence}",
        advice=cause.advice or "check this robot's network and the setting server",
    )
