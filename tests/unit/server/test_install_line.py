"""The line that makes a machine a robot: what it pins, and that no part of it can break out."""

from __future__ import annotations

import shlex

import pytest
from robotether_server.install_line import install_line, parse_site_address, site_of
from robotether_server.problems import FieldInvalid
from robotether_server.settings import SiteAddressSettings
from robotether_server.site_certificate import Certificate, SiteCertificates

FINGERPRINT = "ab" * 32
PIN = "q83vEjRWeJA+/q83vEjRWeJAq83vEjRWeJAq83vEjRW="


class KnownCertificate(SiteCertificates):
    """A front whose certificate is given."""

    def __init__(self, host: str | None, port: int, *, is_known: bool) -> None:
        super().__init__(SiteAddressSettings(host, port, ("nobody", 1)))
        self.given = Certificate(FINGERPRINT, PIN, is_known)

    def certificate(self, host: str) -> Certificate:
        """The given one, whatever the name."""
        return self.given


def test_self_signed_certificate_is_pinned_twice() -> None:
    """By curl for the script, and by the script for all that follows."""
    certificates = KnownCertificate(None, 443, is_known=False)
    assert install_line(certificates, "robots.example:8443", "rj_abc") == (
        f"curl -fsSk --pinnedpubkey sha256//{PIN} https://robots.example:8443/join.sh | "
        f"sudo sh -s -- --server robots.example:8443 --tls-fingerprint {FINGERPRINT} --token rj_abc"
    )


def test_known_certificate_is_left_to_the_authorities() -> None:
    """So that it may be renewed."""
    certificates = KnownCertificate("robots.example", 443, is_known=True)
    assert install_line(certificates, "10.0.0.1", "rj_abc") == (
        "curl -fsS https://robots.example/join.sh | sudo sh -s -- --server robots.example --token rj_abc"
    )


def test_token_is_one_word_whatever_it_is() -> None:
    """The shell sees it as one argument."""
    line = install_line(KnownCertificate("a", 443, is_known=True), "", "rj_$(reboot) '; x")
    assert shlex.split(line)[-1] == "rj_$(reboot) '; x"


@pytest.mark.parametrize(
    ("host", "port", "authority"),
    [
        ("robots.example", 443, "robots.example"),
        ("robots.example", 8443, "robots.example:8443"),
        ("2001:db8::1", 443, "[2001:db8::1]"),
        ("2001:db8::1", 8443, "[2001:db8::1]:8443"),
    ],
)
def test_public_host_and_port_win(host: str, port: int, authority: str) -> None:
    """An admin who works from inside still gets the line for robots outside."""
    assert (
        site_of(SiteAddressSettings(host, port, ("nginx", 8443)), "10.0.0.1").authority == authority
    )


@pytest.mark.parametrize("text", ["robots.example", "robots.example:8443", "[::1]:444", "10.0.0.1"])
def test_sites_are_read_as_they_are_written(text: str) -> None:
    """What the header Host has is what the line has."""
    assert parse_site_address(text).authority == text


@pytest.mark.parametrize(
    "text", ["", "a b", "a;reboot", "$(x)", "a/b", "a:b", "::1", "u@a", "a\nb", ".a", "a" * 64]
)
def test_host_that_is_none_is_refused(text: str) -> None:
    """A header is a stranger's text until it is checked."""
    with pytest.raises(FieldInvalid, match="cannot use host"):
        parse_site_address(text)
