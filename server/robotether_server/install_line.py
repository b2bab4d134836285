"""Writes the line that makes a machine a robot of this site, for people to copy into its shell.

Pure text, used by web and cli; site_certificate.py finds out about the certificate.
"""

import re
import shlex
from dataclasses import dataclass

from robotether_server.problems import FieldInvalid
from robotether_server.settings import SiteAddressSettings
from robotether_server.site_certificate import SiteCertificates

HTTPS_PORT = 443
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


def parse_site_address(text: str) -> SiteAddress:
    """Read HOST or HOST:PORT, as in the header Host; raise FieldInvalid."""
    found = _SITE.fullmatch(text)
    if found is None:
        raise FieldInvalid(f"cannot use host {text[:80]!r}: it must be a host name or an address")
    return SiteAddress(found["host"].strip("[]"), int(found["port"] or HTTPS_PORT))


def site_of(settings: SiteAddressSettings, asked: str) -> SiteAddress:
    """Return where robots reach this site: at PUBLIC_HOST, or else where who asks for the line did (`asked`)."""
    if settings.public_host is not None:
        return SiteAddress(settings.public_host, settings.public_port)
    return parse_site_address(asked)


def install_line(certificates: SiteCertificates, asked: str, token: str) -> str:
    """Return the line; raise SiteCertificateUnavailable or FieldInvalid.

    `asked`: HOST[:PORT] of who asks, which counts where PUBLIC_HOST is not set.
    """
    site = site_of(certificates.settings, asked)
    certificate = certificates.certificate(site.host)
    fetch, run = ["curl", "-fsS"], ["sudo", "sh", "-s", "--", "--server", site.authority]
    if not certificate.is_known:
        # -k stops curl from asking the system's authorities; the pin is then what is checked.
        fetch[1:] = ["-fsSk", "--pinnedpubkey", f"sha256//{certificate.pin}"]
        run += ["--tls-fingerprint", certificate.fingerprint]
    fetch.append(f"https://{site.authority}/join.sh")
    return f"{shlex.join(fetch)} | {shlex.join([*run, '--token', token])}"
