"""The certificate that nginx shows, against a real TLS server and what openssl says of it."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterator
from pathlib import Path

import pytest
import tls_front
from local_network import free_port
from robotether_server.problems import SiteCertificateUnavailable
from robotether_server.settings import SiteAddressSettings
from robotether_server.site_certificate import CACHE_S, MAX_CACHED, SiteCertificates
from tls_front import TlsFront, openssl


@pytest.fixture
def shown(tmp_path: Path) -> Iterator[TlsFront]:
    """A server with a self-signed certificate."""
    with tls_front.running(tmp_path) as certificates:
        yield certificates


def certificates_of(shown: TlsFront, **options: object) -> SiteCertificates:
    return SiteCertificates(SiteAddressSettings(None, 443, shown.endpoint), **options)  # type: ignore[arg-type] # only `now`


def test_fingerprint_and_pin_are_those_of_openssl(shown: TlsFront) -> None:
    """What people compare with openssl, and what curl computes."""
    found = certificates_of(shown).certificate("localhost")
    pem = str(shown.certificate)
    printed = openssl("x509", "-in", pem, "-noout", "-fingerprint", "-sha256").decode().strip()
    assert found.fingerprint == printed.split("=")[1].replace(":", "").lower()
    key = openssl("x509", "-in", pem, "-noout", "-pubkey")
    public = openssl("pkey", "-pubin", "-outform", "DER", stdin=key)
    assert found.pin == base64.b64encode(hashlib.sha256(public).digest()).decode()
    assert not found.is_known


@pytest.mark.parametrize(
    ("host", "is_known"), [("localhost", True), ("127.0.0.1", True), ("elsewhere.example", False)]
)
def test_authorities_are_asked_for_a_name(
    shown: TlsFront, monkeypatch: pytest.MonkeyPatch, host: str, is_known: bool
) -> None:
    """A certificate that is trusted under another name alone is not known."""
    monkeypatch.setenv("SSL_CERT_FILE", str(shown.certificate))
    assert certificates_of(shown).certificate(host).is_known == is_known


def test_certificate_is_kept_for_a_minute(shown: TlsFront) -> None:
    """Then a new one is seen."""
    now = 1000.0
    certificates = certificates_of(shown, now=lambda: now)
    certificates.certificate("localhost")
    asked = shown.handshakes
    now += CACHE_S - 1
    certificates.certificate("localhost")
    assert shown.handshakes == asked
    now += 2
    certificates.certificate("localhost")
    assert shown.handshakes == 2 * asked


def test_many_names_do_not_fill_the_memory(shown: TlsFront) -> None:
    """The name comes from outside."""
    certificates = certificates_of(shown)
    for number in range(MAX_CACHED + 2):
        certificates.certificate(f"host{number}.example")
    assert len(certificates._cached) <= MAX_CACHED


def test_no_certificate_is_said_so() -> None:
    """Nobody listens: a sentence, not a traceback."""
    certificates = SiteCertificates(SiteAddressSettings(None, 443, ("127.0.0.1", free_port())))
    with pytest.raises(
        SiteCertificateUnavailable, match=r"cannot determine this site's certificate: 127\.0\.0\.1"
    ):
        certificates.certificate("localhost")
