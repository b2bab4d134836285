"""The controller's way to a Robotether server: JSON over https, with the certificate pinned or checked.

Used by modules and inventory. Standard library only, since it runs wherever Ansible runs. It sends nothing, the token
least of all, before the certificate was compared; it follows no redirect.
"""

from __future__ import annotations

import hashlib
import http.client
import json
import re
import ssl
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

TIMEOUT_S = 15.0
# A fleet's robots with all their settings.
ANSWER_LIMIT = 32 * 1024 * 1024
OK = 200
# Before the names of options in the roles.
ROLE_PREFIX = "robotether_agent_"

# What to do about a refusal, by its code.
ADVICE = {
    "token_invalid": "set ROBOTETHER_TOKEN (or robotether_agent_token) to an API token; a join token only enrols",
    "token_expired": "make a new token: robotether robot invite, or robotether token create",
    "token_used_up": "make a new token with more uses: robotether robot invite",
    "grant_missing": "use an API token of a user with role admin",
    "record_exists": "choose another robotether_agent_name, or retire the robot that has it",
    "mac_in_use": (
        "if they are two robots with one MAC, set robotether_agent_interface to another interface of this one"
    ),
    "key_in_use": "this robot's disk is a copy of another's: run 'robotether-agent forget' on it, then this again",
    "robot_disabled": "enable the robot on the server, then run this again",
    "key_rejected": "an admin rejected this key: allow it to ask again on the server's page of pending robots",
    "field_invalid": "correct what it comes from: robotether_agent_mac, _interface, _allow_local_mac or _name",
}

# Arguments of every module that asks the server.
ARGUMENTS: dict[str, Any] = {
    "server": {"type": "str", "required": True},
    "tls_fingerprint": {"type": "str", "default": ""},
    "ca_file": {"type": "path", "default": None},
    "token": {"type": "str", "required": True, "no_log": True},
}


class ServerError(Exception):
    """The server cannot be asked, or refuses; the text is a sentence for people."""

    def __init__(self, sentence: str, code: str = "server_unreachable") -> None:
        super().__init__(sentence)
        self.code = code


@dataclass(frozen=True)
class Server:
    """One server and the token that speaks for us; `fingerprint` is 64 hexadecimal digits or empty.

    `prefix` goes before the names of options where a sentence says which one to correct.
    """

    address: str
    token: str
    fingerprint: str = ""
    ca_file: str | None = None
    prefix: str = ROLE_PREFIX

    @classmethod
    def of(cls, params: Mapping[str, Any], prefix: str = ROLE_PREFIX) -> Server:
        """Return the server that ARGUMENTS name."""
        fingerprint = digits_of(params["tls_fingerprint"], prefix)
        # As a file has it, with the end of its line.
        token = params["token"].strip()
        if not (token.isascii() and token.isprintable()):
            # Not as it is: what Python says of such a header has the token, which Ansible does not know there.
            raise ServerError(
                "cannot use the token: it has characters that no token has", "token_invalid"
            )
        return cls(params["server"], token, fingerprint, params["ca_file"], prefix)

    def connect(self) -> http.client.HTTPSConnection:
        """Return an open connection whose certificate is the right one."""
        host, port = host_and_port(self.address, self.prefix)
        connection = http.client.HTTPSConnection(
            host, port, timeout=TIMEOUT_S, context=self._context()
        )
        try:
            connection.connect()
        except ssl.SSLCertVerificationError as error:
            raise ServerError(
                f"cannot trust the certificate of {self.address}: {error.verify_message}; set "
                f"{self.prefix}tls_fingerprint to the SHA-256 that the server printed",
                "tls_untrusted",
            ) from error
        except OSError as error:
            raise ServerError(
                f"cannot reach https://{self.address} from the Ansible controller: {reason_of(error)}; "
                f"check {self.prefix}server and that the server is up"
            ) from error
        self._compare(connection)
        return connection

    def ask(self, method: str, path: str, body: object = None) -> tuple[int, dict[str, Any]]:
        """Return status and JSON object of one request; raise ServerError when there is no such answer."""
        status, answer = self._exchange(method, path, body)
        return status, self._parsed(status, answer)

    def get(self, path: str) -> dict[str, Any]:
        """Return the JSON object that a GET answers; raise ServerError when the server refuses."""
        status, answer = self._exchange("GET", path)
        parsed = self._parsed(status, answer)
        if status != OK:
            raise refusal(f"get {path}", status, parsed)
        return parsed

    def get_text(self, path: str) -> str:
        """Return the text that a GET answers; raise ServerError when the server refuses."""
        status, answer = self._exchange("GET", path)
        if status != OK:
            raise refusal(f"get {path}", status, self._parsed(status, answer))
        return answer.decode(errors="replace")

    def headers(self) -> dict[str, str]:
        """Return the headers of a request in JSON that the token vouches for."""
        return {"Content-Type": "application/json", "Authorization": f"Bearer {self.token}"}

    def _exchange(self, method: str, path: str, body: object = None) -> tuple[int, bytes]:
        connection = self.connect()
        try:
            data = None if body is None else json.dumps(body).encode()
            connection.request(method, path, body=data, headers=self.headers())
            answer = connection.getresponse()
            return answer.status, answer.read(ANSWER_LIMIT)
        except (OSError, http.client.HTTPException) as error:
            raise ServerError(
                f"cannot ask https://{self.address}: {reason_of(error)}; try again"
            ) from error
        finally:
            connection.close()

    def _context(self) -> ssl.SSLContext:
        context = trusting(self.ca_file)
        if self.fingerprint:
            # The comparison of the whole certificate takes the place of names and authorities.
            context.check_hostname = False
            context.verify_mode = ssl.CERT_NONE
        return context

    def _compare(self, connection: http.client.HTTPSConnection) -> None:
        seen = hashlib.sha256(connection.sock.getpeercert(binary_form=True) or b"").hexdigest()
        if self.fingerprint and seen != self.fingerprint:
            connection.close()
            raise ServerError(
                f"cannot trust {self.address}: its certificate has the SHA-256 {seen}, but {self.prefix}tls_"
                f"fingerprint is {self.fingerprint}; compare both with the one that the server printed",
                "tls_untrusted",
            )

    def _parsed(self, status: int, body: bytes) -> dict[str, Any]:
        if not body:
            return {}
        try:
            answer = json.loads(body)
        except ValueError:
            answer = None
        if not isinstance(answer, dict):
            raise ServerError(
                f"cannot use {self.address}: it answers with HTTP status {status} and not as a Robotether "
                f"server does; check {self.prefix}server",
                "answer_invalid",
            )
        return answer


def trusting(ca_file: str | None) -> ssl.SSLContext:
    """Return what trusts these certificates, or the system's; ServerError where they cannot be read."""
    try:
        return ssl.create_default_context(cafile=ca_file)
    except OSError as error:
        raise ServerError(
            f"cannot use ca_file {ca_file!r}: allowed is a readable file of certificates in PEM",
            "tls_untrusted",
        ) from error


def reason_of(error: Exception) -> str:
    """Return why a connection failed, in words for people: no class, no line of Python's source."""
    if isinstance(error, ssl.SSLError):
        return f"TLS fails ({error.reason or 'the connection ended'})"
    if isinstance(error, OSError):
        return error.strerror or str(error)
    return "what answers there does not speak HTTP"


def refusal(action: str, status: int, answer: Mapping[str, Any]) -> ServerError:
    """Return the server's refusal as a sentence with its code."""
    code = str(answer.get("code", "answer_invalid"))
    detail = str(answer.get("detail", f"the server answers with HTTP status {status}"))
    sentence = detail if detail.startswith("cannot ") else f"cannot {action}: {detail}"
    advice = ADVICE.get(code, "see the server's log: tools/compose logs web")
    return ServerError(f"{sentence}; {advice} [{code}]", code)


def digits_of(fingerprint: str, prefix: str = ROLE_PREFIX) -> str:
    """Return a SHA-256 in any usual spelling as 64 lower-case digits; ServerError when it is none."""
    digits = re.sub("^sha256:|:", "", fingerprint.strip().lower())
    if digits and not re.fullmatch(r"[0-9a-f]{64}", digits):
        raise ServerError(
            f"cannot use {prefix}tls_fingerprint {fingerprint!r}: allowed is the certificate's SHA-256, "
            "64 hexadecimal digits",
            "tls_untrusted",
        )
    return digits


def host_and_port(address: str, prefix: str = ROLE_PREFIX) -> tuple[str, int]:
    """Return the parts of HOST or HOST:PORT; ServerError for anything else."""
    try:
        parts = urlsplit(f"//{address}")
        port = parts.port or 443
        # As socket does it, where a label may be too long.
        (parts.hostname or "").encode("idna")
    except ValueError:
        parts, port = urlsplit("//"), 0
    if not parts.hostname or parts.path or parts.query or parts.username is not None:
        raise ServerError(
            f"cannot use {prefix}server {address!r}: allowed is HOST or HOST:PORT, without https://"
        )
    return parts.hostname, port
