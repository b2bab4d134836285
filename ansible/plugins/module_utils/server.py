"""The controller's way to a Robotether server: JSON over https, with the certificate pinned or checked.

Used by this role's modules. Standard library only, since it runs wherever Ansible runs. It sends nothing, the token
least of all, before the certificate was compared; it follows no redirect.
"""

from __future__ import annotations

import hashlib
import http.client
import json
import re
import ssl
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

TIMEOUT_S = 15.0
ANSWER_LIMIT = 1024 * 1024

# Arguments that every module of this role that asks the server has.
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
    """One server and the token that speaks for us; `fingerprint` is 64 hexadecimal digits or empty."""

    address: str
    token: str
    fingerprint: str = ""
    ca_file: str | None = None

    @classmethod
    def of(cls, params: dict[str, Any]) -> Server:
        """Return the server that a module's ARGUMENTS name."""
        fingerprint = digits_of(params["tls_fingerprint"])
        return cls(params["server"], params["token"], fingerprint, params["ca_file"])

    def connect(self) -> http.client.HTTPSConnection:
        """Return an open connection whose certificate is the right one."""
        host, port = host_and_port(self.address)
        connection = http.client.HTTPSConnection(
            host, port, timeout=TIMEOUT_S, context=self._context()
        )
        try:
            connection.connect()
        except ssl.SSLCertVerificationError as error:
            raise ServerError(
                f"cannot trust the certificate of {self.address}: {error.verify_message}; set "
                "robotether_agent_tls_fingerprint to the SHA-256 that the server printed",
                "tls_untrusted",
            ) from error
        except OSError as error:
            raise ServerError(
                f"cannot reach https://{self.address} from the Ansible controller: {error.strerror or error}; "
                "check robotether_agent_server and that the server is up"
            ) from error
        self._compare(connection)
        return connection

    def ask(self, method: str, path: str, body: object = None) -> tuple[int, dict[str, Any]]:
        """Return status and JSON object of one request; raise ServerError when there is no such answer."""
        connection = self.connect()
        try:
            data = None if body is None else json.dumps(body).encode()
            connection.request(method, path, body=data, headers=self.headers())
            answer = connection.getresponse()
            return answer.status, self._parsed(answer.status, answer.read(ANSWER_LIMIT))
        except (OSError, http.client.HTTPException) as error:
            raise ServerError(f"cannot ask https://{self.address}: {error}; try again") from error
        finally:
            connection.close()

    def headers(self) -> dict[str, str]:
        """Return the headers of a request in JSON that the token vouches for."""
        return {"Content-Type": "application/json", "Authorization": f"Bearer {self.token}"}

    def _context(self) -> ssl.SSLContext:
        context = ssl.create_default_context(cafile=self.ca_file)
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
                f"cannot trust {self.address}: its certificate has the SHA-256 {seen}, but robotether_agent_tls_"
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
                "server does; check robotether_agent_server",
                "answer_invalid",
            )
        return answer


def digits_of(fingerprint: str) -> str:
    """Return a SHA-256 in any usual spelling as 64 lower-case digits; ServerError when it is none."""
    digits = fingerprint.strip().lower().removeprefix("sha256:").replace(":", "")
    if digits and not re.fullmatch(r"[0-9a-f]{64}", digits):
        raise ServerError(
            f"cannot use robotether_agent_tls_fingerprint {fingerprint!r}: allowed is the certificate's SHA-256, "
            "64 hexadecimal digits",
            "tls_untrusted",
        )
    return digits


def host_and_port(address: str) -> tuple[str, int]:
    """Return the parts of HOST or HOST:PORT; ServerError for anything else."""
    try:
        parts = urlsplit(f"//{address}")
        port = parts.port or 443
    except ValueError:
        parts, port = urlsplit("//"), 0
    if not parts.hostname or parts.path or parts.query or parts.username is not None:
        raise ServerError(
            f"cannot use robotether_agent_server {address!r}: allowed is HOST or HOST:PORT, without https://"
        )
    return parts.hostname, port
