"""Writes the line that makes a machine a robot of this site, for people to copy into its shell.

Used by web and cli. The line pins the site's certificate where a robot would not know it. nginx itself is asked for
that, as the certificate's file is nginx's own and may be replaced at any time; never to trust a connection.
"""

import base64
import datetime as dt
import hashlib
import ipaddress
import re
import shlex
import socket
import ssl
import threading
from collections.abc import Callable
from dataclasses import dataclass
from time import monotonic

from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from robotether_server.problems import FieldInvalidError, SiteCertificateUnavailableError, reason_in
from robotether_server.settings.server import SiteAddressSettings

HTTPS_PORT = 443
CERTIFICATE_TIMEOUT_S = 3.0
CERTIFICATE_CACHE_S = 60.0
# Maximum number of cached names; they come with requests and must not fill the memory.
MAX_CACHED = 16
# For whoever is served without a name of the site.
ANY_HOST = "localhost"

_LABEL = r"[A-Za-z0-9]([A-Za-z0-9-]{0,61}[A-Za-z0-9])?"
_HOST = rf"(?=.{{1,253}}(:|\Z)){_LABEL}(\.{_LABEL})*"
_SITE = re.compile(rf"(?P<host>{_HOST}|\[[0-9A-Fa-f:.]{{2,45}}\])(:(?P<port>[0-9]{{1,5}}))?")


@dataclass(frozen=True)
class SiteAddress:
    """A name or address (IPv6 without brackets) and a port."""

    host: str
    port: int = HTTPS_PORT

    @property
    def authority(self) -> str:
        """The site as in URLs: HOST or HOST:PORT."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return host if self.port == HTTPS_PORT else f"{host}:{self.port}"


@dataclass(frozen=True)
class Certificate:
    """What a client can compare: SHA-256 of the certificate in hex, of its public key in base64 (curl's pin).

    `is_known`: this machine's authorities have signed it under the name that was asked for. `ends_at` None: unknown.
    """

    fingerprint: str
    pin: str
    is_known: bool
    ends_at: dt.datetime | None = None


class SiteCertificates:
    """The certificate of one site, learnt when it is needed and kept for a minute; safe to share between threads."""

    def __init__(self, settings: SiteAddressSettings, now: Callable[[], float] = monotonic) -> None:
        self.settings = settings
        self._now = now
        self._lock = threading.Lock()
        self._cached: dict[str, tuple[float, Certificate]] = {}

    def certificate(self, host: str) -> Certificate:
        """Return the certificate, judged for this name or address; raise SiteCertificateUnavailableError."""
        with self._lock:
            learnt_at, cached = self._cached.get(host, (0.0, None))
            if cached is not None and self._now() - learnt_at < CERTIFICATE_CACHE_S:
                return cached
            certificate = learn_certificate(self.settings.tls_front, host)
            if len(self._cached) >= MAX_CACHED:
                self._cached.clear()
            self._cached[host] = (self._now(), certificate)
            return certificate

    def own(self) -> Certificate:
        """Return it as `certificate` does, under the site's own name, if it has one."""
        return self.certificate(self.settings.public_host or ANY_HOST)


@dataclass(frozen=True)
class EnrolmentLines:
    """The ways to enrol a robot, each a line for a shell.

    `install`: on the robot. `package`: before it, where the robot has no internet. `containers`: in ros/ of a checkout
    on the robot. `playbook`: in ansible/ of a checkout.
    """

    install: str
    package: str
    containers: str
    playbook: str
    # Why no robot can use them; empty: nothing is known against the address.
    warning: str = ""


def enrolment_lines(
    certificates: SiteCertificates, address: str, token: str, name: str | None = None
) -> EnrolmentLines:
    """Return the lines; raise SiteCertificateUnavailableError or FieldInvalidError.

    `address`: HOST[:PORT] of the request, which counts where PUBLIC_HOST is not set. `name`: which the robot asks for.
    """
    site = site_of(certificates.settings, address)
    certificate = certificates.certificate(site.host)
    fetch, run = ["curl", "-fsS"], ["sudo", "sh", "-s", "--", "--server", site.authority]
    variables = {"SERVER": site.authority}
    if not certificate.is_known:
        # -k stops curl from asking the system's authorities; the pin is then what is checked.
        fetch[1:] = ["-fsSk", "--pinnedpubkey", f"sha256//{certificate.pin}"]
        run += ["--tls-fingerprint", certificate.fingerprint]
        variables["TLS_FINGERPRINT"] = certificate.fingerprint
    if name is not None:
        run += ["--name", name]
        variables["NAME"] = name
    url = f"https://{site.authority}"
    package = shlex.join([*fetch, "-o", "agent.deb", f"{url}/agent.deb"])
    return EnrolmentLines(
        install=f"{shlex.join([*fetch, f'{url}/join.sh'])} | {shlex.join([*run, '--token', token])}",
        package=f"{package} && sudo apt install ./agent.deb",
        containers=f"{_assignments(variables | {'TOKEN': token})} docker compose up -d",
        playbook=f"{_assignments({'ROBOTETHER_TOKEN': token})} ansible-playbook enroll.yml",
        warning=unreachable_warning(site),
    )


def unreachable_warning(site: SiteAddress) -> str:
    """Say that no robot can reach this site by its address, if that is certain; else return nothing."""
    if not _is_this_machine(site.host.lower()):
        return ""
    return (
        f"No robot can use this line: {site.host} is the robot itself there. Set PUBLIC_HOST to a name or address of "
        "this server that robots reach, or give one in this page's address or with --host, and make a new line."
    )


def _is_this_machine(host: str) -> bool:
    if host == "localhost" or host.endswith((".localhost", ".localdomain")):
        return True
    try:
        # Short forms such as 127.1 are addresses for curl, too.
        address = ipaddress.ip_address(host if ":" in host else socket.inet_aton(host))
    except (OSError, ValueError):
        return False
    address = getattr(address, "ipv4_mapped", None) or address
    return address.is_loopback or address.is_unspecified


def _assignments(variables: dict[str, str]) -> str:
    # Quoted as a whole it would be the name of a command.
    return " ".join(f"{name}={shlex.quote(value)}" for name, value in variables.items())


def parse_site_address(text: str) -> SiteAddress:
    """Read HOST or HOST:PORT, as in the header Host; raise FieldInvalidError."""
    match = _SITE.fullmatch(text)
    if match is None:
        raise FieldInvalidError(
            f"cannot use host {text[:80]!r}: it must be a host name or an address"
        )
    return SiteAddress(match["host"].strip("[]"), int(match["port"] or HTTPS_PORT))


def site_of(settings: SiteAddressSettings, address: str) -> SiteAddress:
    """Return where robots reach this site: at PUBLIC_HOST, or else at the address of the request."""
    if settings.public_host is not None:
        return SiteAddress(settings.public_host, settings.public_port)
    return parse_site_address(address)


def learn_certificate(endpoint: tuple[str, int], host: str) -> Certificate:
    """Ask for the certificate that a client of this host gets; raise SiteCertificateUnavailableError."""
    try:
        der = _certificate_of(endpoint, host, _unchecked())
        return describe_certificate(der, is_known=_is_known(endpoint, host))
    except (OSError, ValueError) as error:
        raise SiteCertificateUnavailableError(
            f"cannot determine this site's certificate: {endpoint[0]}:{endpoint[1]} does not show one "
            f"({reason_in(error)}); try again, and see the log of nginx"
        ) from error


def describe_certificate(der: bytes, *, is_known: bool) -> Certificate:
    """Return what a certificate in DER is compared by."""
    certificate = x509.load_der_x509_certificate(der)
    public = certificate.public_key().public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)
    pin = base64.b64encode(hashlib.sha256(public).digest()).decode()
    fingerprint = hashlib.sha256(der).hexdigest()
    return Certificate(fingerprint, pin, is_known, certificate.not_valid_after_utc)


def _unchecked() -> ssl.SSLContext:
    context = ssl.create_default_context()
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    return context


def _is_known(endpoint: tuple[str, int], host: str) -> bool:
    try:
        _certificate_of(endpoint, host, ssl.create_default_context())
    except ssl.SSLCertVerificationError:
        return False
    return True


def _certificate_of(endpoint: tuple[str, int], host: str, context: ssl.SSLContext) -> bytes:
    with (
        socket.create_connection(endpoint, CERTIFICATE_TIMEOUT_S) as plain,
        context.wrap_socket(plain, server_hostname=host) as tls,
    ):
        return tls.getpeercert(binary_form=True) or b""
