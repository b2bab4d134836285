"""Says in a sentence why something failed on the network or on this machine, and what a person can do about it.

For health probes, joins and the doctor. A library's own text never reaches a person: it may hold a class, an object's
address or a proxy's password. What no table here knows goes to the log of level debug as it is.
"""

from __future__ import annotations

import asyncio
import errno
import logging
import os
import re
import socket
import ssl
from collections.abc import Mapping
from dataclasses import dataclass

import aiohttp

from robotether_agent.fields import FieldError, printable
from robotether_agent.files import MACHINE_FAULTS

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Cause:
    """Why something failed; `advice` is there where it does not depend on what was asked."""

    sentence: str = ""
    advice: str = ""

    def __bool__(self) -> bool:
        return bool(self.sentence)


NO_CAUSE = Cause()
NETWORK_ADVICE = "check this robot's own network: cable or Wi-Fi, its address, its route (ip route)"
NAME_ADVICE = (
    "check how the settings spell the name, and this robot's name service (resolvectl status)"
)
SILENT_ADVICE = (
    "see that the server runs and is not overloaded; else try a smaller MTU, since large packets may be lost on the "
    "way (sudo ip link set dev INTERFACE mtu 1280)"
)
MITM_ADVICE = "see that the address names the https port, and that no captive portal is in between"
CLOCK_ADVICE = "set the clock: sudo timedatectl set-ntp true"
CHAIN_ADVICE = "let the server send its whole chain, or set ca_file to the authority's certificate, or tls_fingerprint"
PURPOSE_ADVICE = "make a new certificate, for a server; or set tls_fingerprint"
UNKNOWN = Cause("it fails in a way that this program does not know; log_level = debug shows it")

CUT = Cause("it cuts the connection")
SILENT_END = Cause("it closes the connection without an answer")
NO_ROUTE = "no route leads there"
FORBIDDEN = Cause("this machine's own rules forbid it", "see its firewall (nft list ruleset)")
BY_ERRNO: Mapping[int, Cause] = {
    errno.ENETUNREACH: Cause(NO_ROUTE, NETWORK_ADVICE),
    errno.ENETDOWN: Cause("this robot's network is down", NETWORK_ADVICE),
    errno.EHOSTUNREACH: Cause(f"{NO_ROUTE}, or nobody there has this address", NETWORK_ADVICE),
    errno.EADDRNOTAVAIL: Cause("this robot has no address for that", NETWORK_ADVICE),
    errno.EAFNOSUPPORT: Cause("this robot has no network of that kind", NETWORK_ADVICE),
    errno.ECONNRESET: CUT,
    errno.ECONNABORTED: CUT,
    errno.EPIPE: CUT,
    errno.ESHUTDOWN: CUT,
    errno.ETIMEDOUT: Cause("the connection fell silent", SILENT_ADVICE),
    errno.EACCES: FORBIDDEN,
    errno.EPERM: FORBIDDEN,
    **{number: Cause(*fault) for number, fault in MACHINE_FAULTS.items()},
    errno.ENOBUFS: Cause("this machine has no memory left for its network", "free, top, ss -s"),
}
# Exceptions that come without a number, too.
BY_CLASS: Mapping[type[BaseException], int] = {
    ConnectionRefusedError: errno.ECONNREFUSED,
    ConnectionError: errno.ECONNRESET,
    PermissionError: errno.EPERM,
    MemoryError: errno.ENOMEM,
}
NAME_UNKNOWN = Cause("no name service knows this name (Name or service not known)", NAME_ADVICE)
BY_NAME_ERROR: Mapping[int, Cause] = {
    socket.EAI_NONAME: NAME_UNKNOWN,
    socket.EAI_NODATA: Cause("the name service knows no address of this name", NAME_ADVICE),
    socket.EAI_AGAIN: Cause(
        "no name service answers (Temporary failure in name resolution)",
        "check this robot's network, and its name service (resolvectl status)",
    ),
    socket.EAI_FAIL: Cause(
        "the name service fails", "check this robot's name service (resolvectl status)"
    ),
    socket.EAI_MEMORY: BY_ERRNO[errno.ENOMEM],
    socket.EAI_SYSTEM: Cause("the name service fails", NAME_ADVICE),
}

TLS_FAILS = Cause("TLS fails", MITM_ADVICE)
NO_TLS = Cause("what answers there does not speak TLS", MITM_ADVICE)
OTHER_TLS = Cause(
    "it has no version of TLS that this robot accepts",
    "the server, or what is in between, must speak TLS 1.2 or newer",
)
OTHER_CIPHER = Cause(
    "it has no cipher that this robot accepts", "give the server a usual RSA or ECDSA certificate"
)
HANDSHAKE_END = Cause(
    "it closes the connection during the TLS handshake",
    "see the server's log, and that no firewall or proxy in between refuses TLS",
)
TOO_WEAK = Cause(
    "its key or its signature is too weak for this robot's OpenSSL",
    "give the server a key of RSA 2048 or ECDSA P-256, signed with SHA-256",
)
CLIENT_CERTIFICATE = Cause(
    "it wants a client's certificate, which no robot has",
    "see that the address leads to the Robotether server, and not to a gate in front of it",
)
BY_TLS_REASON: Mapping[str, Cause] = {
    "WRONG_VERSION_NUMBER": NO_TLS,
    "HTTP_REQUEST": NO_TLS,
    "PACKET_LENGTH_TOO_LONG": NO_TLS,
    "RECORD_LAYER_FAILURE": NO_TLS,
    "UNEXPECTED_MESSAGE": NO_TLS,
    "UNSUPPORTED_PROTOCOL": OTHER_TLS,
    "NO_PROTOCOLS_AVAILABLE": OTHER_TLS,
    "TLSV1_ALERT_PROTOCOL_VERSION": OTHER_TLS,
    "VERSION_TOO_LOW": OTHER_TLS,
    "NO_SHARED_CIPHER": OTHER_CIPHER,
    "NO_CIPHERS_AVAILABLE": OTHER_CIPHER,
    "SSLV3_ALERT_HANDSHAKE_FAILURE": OTHER_CIPHER,
    "TLSV1_ALERT_INSUFFICIENT_SECURITY": OTHER_CIPHER,
    "DH_KEY_TOO_SMALL": TOO_WEAK,
    "EE_KEY_TOO_SMALL": TOO_WEAK,
    "CA_MD_TOO_WEAK": TOO_WEAK,
    "UNEXPECTED_EOF_WHILE_READING": HANDSHAKE_END,
    "TLSV1_UNRECOGNIZED_NAME": Cause(
        "it does not serve this name", "check how the settings spell the server's name"
    ),
    "TLSV13_ALERT_CERTIFICATE_REQUIRED": CLIENT_CERTIFICATE,
    "SSLV3_ALERT_BAD_CERTIFICATE": CLIENT_CERTIFICATE,
}

UNKNOWN_ISSUER = Cause(
    "this robot does not know its authority, or the server leaves out a part of its chain",
    CHAIN_ADVICE,
)
OTHER_NAME = Cause(
    "it is for another name",
    "set server to a name that is in the certificate, or give the server one for its name; or set tls_fingerprint",
)
NOT_FOR_SERVERS = Cause("it, or one of its chain, may not be used like that", PURPOSE_ADVICE)
# OpenSSL's X509_V_ERR_ numbers.
NOT_YET_VALID, EXPIRED = 9, 10
STRICT = range(80, 95)
BY_VERIFY_CODE: Mapping[int, Cause] = {
    2: UNKNOWN_ISSUER,
    7: Cause(
        "a signature in its chain is wrong",
        "if the server's authority has another key now, set ca_file to its new certificate; else find out who is in "
        "between",
    ),
    NOT_YET_VALID: Cause("it is not yet valid", CLOCK_ADVICE),
    EXPIRED: Cause("it has expired", f"renew it on the server, or {CLOCK_ADVICE}"),
    18: Cause("it is self-signed", "set tls_fingerprint or ca_file"),
    19: Cause("its chain ends in an authority that this robot does not know", CHAIN_ADVICE),
    20: UNKNOWN_ISSUER,
    21: UNKNOWN_ISSUER,
    23: Cause("its authority has revoked it", "give the server another certificate"),
    25: NOT_FOR_SERVERS,
    26: NOT_FOR_SERVERS,
    32: NOT_FOR_SERVERS,
    37: NOT_FOR_SERVERS,
    62: OTHER_NAME,
    64: OTHER_NAME,
    66: TOO_WEAK,
    67: TOO_WEAK,
    68: TOO_WEAK,
    76: TOO_WEAK,
    79: NOT_FOR_SERVERS,
}

# In this order: a class comes before those that it is made of.
BY_HTTP_CLASS: tuple[tuple[type[BaseException], Cause], ...] = (
    (aiohttp.InvalidURL, Cause("its address is not one of HTTP")),
    (aiohttp.NonHttpUrlClientError, Cause("its address is not one of HTTP")),
    (aiohttp.TooManyRedirects, Cause("it redirects without end", MITM_ADVICE)),
    (aiohttp.ContentTypeError, Cause("it answers with another kind of content", MITM_ADVICE)),
    (aiohttp.ClientResponseError, Cause("what it answers is not HTTP", MITM_ADVICE)),
    (aiohttp.ClientPayloadError, Cause("its answer is cut short")),
    (aiohttp.ServerDisconnectedError, SILENT_END),
    (aiohttp.ClientConnectionError, CUT),
    (aiohttp.WebSocketError, Cause("it breaks the rules of a WebSocket")),
    (aiohttp.WSMessageTypeError, Cause("it sends another kind of message than it should")),
    (UnicodeError, Cause("its name or its answer is not text", NAME_ADVICE)),
    (EOFError, SILENT_END),
)
NUMBERS = re.compile(r"\[Errno (\d+)\]")
REASON = re.compile(r"\[\w+: ([A-Z0-9_]+)\]")


def describe_error(error: BaseException, timeout_s: float) -> str:
    """Return the reason in `error`; `timeout_s` is how long was waited, if that is the reason."""
    return cause_of(error, timeout_s).sentence


def cause_of(error: BaseException, timeout_s: float) -> Cause:
    """Return the reason in `error`, and what to do about it."""
    error = _wrapped(error)
    if isinstance(error, FieldError):
        # Its text is ours.
        return Cause(printable(str(error), 200))
    if isinstance(error, ssl.SSLError):
        return _cause_in_tls(error)
    if isinstance(error, socket.gaierror):
        return BY_NAME_ERROR.get(error.errno or 0, NAME_UNKNOWN)
    if isinstance(error, aiohttp.ClientResponseError) and error.status:
        return _cause_in_answer(error)
    return _by_number(error) or _by_class(error, timeout_s)


def _wrapped(error: BaseException) -> BaseException:
    """Return what aiohttp's error wraps."""
    if isinstance(error, aiohttp.ClientConnectorCertificateError):
        return error.certificate_error
    return error.os_error if isinstance(error, aiohttp.ClientConnectorError) else error


def _cause_in_tls(error: ssl.SSLError) -> Cause:
    if isinstance(error, ssl.SSLCertVerificationError):
        code = getattr(error, "verify_code", 0)
        words = printable(getattr(error, "verify_message", ""), 80)
        if code in STRICT:
            return Cause(
                f"OpenSSL's strict rules, which Python has from 3.13 on, refuse it ({words})",
                "make new certificates, for authority and server, with basicConstraints, keyUsage, "
                "subjectKeyIdentifier and authorityKeyIdentifier; or set tls_fingerprint",
            )
        return BY_VERIFY_CODE.get(code) or Cause(f"it is refused ({words or 'no reason'})")
    if isinstance(error, ssl.SSLEOFError | ssl.SSLZeroReturnError):
        return HANDSHAKE_END
    named = REASON.search(str(error))
    reason = getattr(error, "reason", None) or (named[1] if named else "no reason")
    cause = BY_TLS_REASON.get(reason, TLS_FAILS)
    # The name is what people search for.
    return Cause(f"{cause.sentence} ({printable(reason, 80)})", cause.advice)


def _cause_in_answer(error: aiohttp.ClientResponseError) -> Cause:
    if isinstance(error, aiohttp.WSServerHandshakeError):
        return Cause(f"it answers with HTTP status {error.status}, not with a WebSocket")
    if isinstance(error, aiohttp.ClientHttpProxyError):
        # Its own text has the proxy's password.
        return Cause(printable(f"the HTTP proxy answers {error.status} {error.message}", 200))
    return _by_class(error, 0)


def _by_number(error: BaseException) -> Cause | None:
    """Return what the system's error numbers mean, of which several attempts have several."""
    number = getattr(error, "errno", None)
    texts = NUMBERS.findall(str(error)) if isinstance(error, OSError) else []
    numbers = [number] if isinstance(number, int) and number > 0 else map(int, texts)
    causes = dict.fromkeys(map(_numbered, numbers))
    if not causes:
        return None
    return Cause(
        ", or ".join(cause.sentence for cause in causes),
        next((cause.advice for cause in causes if cause.advice), ""),
    )


def _numbered(number: int) -> Cause:
    cause, words = BY_ERRNO.get(number), os.strerror(number)
    return Cause(f"{cause.sentence} ({words})", cause.advice) if cause else Cause(words)


def _by_class(error: BaseException, timeout_s: float) -> Cause:
    if isinstance(error, asyncio.TimeoutError | TimeoutError):
        return Cause(f"no answer in {timeout_s:g} s")
    for kind, number in BY_CLASS.items():
        if isinstance(error, kind):
            return _numbered(number)
    for kind, cause in BY_HTTP_CLASS:
        if isinstance(error, kind):
            return cause
    log.debug("an error that no table knows", exc_info=error)
    return UNKNOWN
