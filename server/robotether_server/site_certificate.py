"""Reads the certificate that nginx shows for this site, and whether a robot would know it.

Used by web and cli for the line that installs a robot. Asks nginx itself, as the certificate's file is
nginx's own and may be replaced at any time. Must never be used to trust a connection.
"""

import base64
import hashlib
import socket
import ssl
import threading
from collections.abc import Callable
from dataclasses import dataclass
from time import monotonic

from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from robotether_server.problems import SiteCertificateUnavailable
from robotether_server.settings import SiteAddressSettings

TIMEOUT_S = 3.0
CACHE_S = 60.0
# The name comes with a request; nobody fills the memory with names.
MAX_CACHED = 16


@dataclass(frozen=True)
class Certificate:
    """What a client can compare: SHA-256 of the certificate in hex, of its public key in base64 (curl's pin).

    `is_known`: this machine's authorities have signed it under the name that was asked for.
    """

    fingerprint: str
    pin: str
    is_known: bool


class SiteCertificates:
    """The certificate of one site, learnt when it is needed and kept for a minute; safe to share between threads."""

    def __init__(self, settings: SiteAddressSettings, now: Callable[[], float] = monotonic) -> None:
        self.settings = settings
        self._now = now
        self._lock = threading.Lock()
        self._cached: dict[str, tuple[float, Certificate]] = {}

    def certificate(self, host: str) -> Certificate:
        """Return the certificate, judged for this name or address; raise SiteCertificateUnavailable."""
        with self._lock:
            learnt_at, cached = self._cached.get(host, (0.0, None))
            if cached is not None and self._now() - learnt_at < CACHE_S:
                return cached
            found = learn(self.settings.tls_front, host)
            if len(self._cached) >= MAX_CACHED:
                self._cached.clear()
            self._cached[host] = (self._now(), found)
            return found


def learn(endpoint: tuple[str, int], host: str) -> Certificate:
    """Ask for the certificate that is shown to who asks for this host; raise SiteCertificateUnavailable."""
    try:
        shown = _shown(endpoint, host, _unchecked())
        return describe(shown, is_known=_is_known(endpoint, host))
    except (OSError, ValueError) as error:
        raise SiteCertificateUnavailable(
            f"cannot determine this site's certificate: {endpoint[0]}:{endpoint[1]} does not show one "
            f"({error}); try again, and see the log of nginx"
        ) from error


def describe(der: bytes, *, is_known: bool) -> Certificate:
    """Return what a certificate in DER is compared by."""
    key = x509.load_der_x509_certificate(der).public_key()
    public = key.public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)
    pin = base64.b64encode(hashlib.sha256(public).digest()).decode()
    return Certificate(hashlib.sha256(der).hexdigest(), pin, is_known)


def _unchecked() -> ssl.SSLContext:
    context = ssl.create_default_context()
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    return context


def _is_known(endpoint: tuple[str, int], host: str) -> bool:
    try:
        _shown(endpoint, host, ssl.create_default_context())
    except ssl.SSLCertVerificationError:
        return False
    return True


def _shown(endpoint: tuple[str, int], host: str, context: ssl.SSLContext) -> bytes:
    with (
        socket.create_connection(endpoint, TIMEOUT_S) as plain,
        context.wrap_socket(plain, server_hostname=host) as tls,
    ):
        return tls.getpeercert(binary_form=True) or b""
