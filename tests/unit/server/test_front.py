"""The certificate that nginx shows, against a real TLS server and what openssl says of it."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterator
from pathlib import Path

import pytest
import tls_front
from local_network import free_port
from robotether_server.front import KEPT_S, MOST_KEPT, Front
from robotether_server.problems import FrontUnavailable
from robotether_server.settings import FrontSettings
from tls_front import TlsFront, openssl


@pytest.fixture
def shown(tmp_path: Path) -> Iterator[TlsFront]:
    """A server with a self-signed certificate."""
    with tls_front.running(tmp_path) as front:
        yield front


def front_of(shown: TlsFront, **options: object) -> Front:
    return Front(FrontSettings(None, 443, shown.endpoint), **options)  # type: ignore[arg-type] # only `now`


def test_fingerprint_and_pin_are_those_of_openssl(shown: TlsFront) -> None:
    """What people compare with openssl, and what curl computes."""
    found = front_of(shown).certificate("localhost")
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
def test_authorities_vouch_for_a_name(
    shown: TlsFront, monkeypatch: pytest.MonkeyPatch, host: str, is_known: bool
) -> None:
    """A certificate that is trusted under another name alone is not known."""
    monkeypatch.setenv("SSL_CERT_FILE", str(shown.certificate))
    assert front_of(shown).certificate(host).is_known == is_known


def test_certificate_is_kept_for_a_minute(shown: TlsFront) -> None:
    """Then a new one is seen."""
    now = 1000.0
    front = front_of(shown, now=lambda: now)
    front.certificate("localhost")
    asked = shown.handshakes
    now += KEPT_S - 1
    front.certificate("localhost")
    assert shown.handshakes == asked
    now += 2
    front.certificate("localhost")
    assert shown.handshakes == 2 * asked


def test_many_names_do_not_fill_the_memory(shown: TlsFront) -> None:
    """The name comes from outside."""
    front = front_of(shown)
    for number in range(MOST_KEPT + 2):
        front.certificate(f"host{number}.example")
    assert len(front._kept) <= MOST_KEPT


def test_no_certificate_is_said_so() -> None:
    """Nobody listens: a sentence, not a traceback."""
    front = Front(FrontSettings(None, 443, ("127.0.0.1", free_port())))
    with pytest.raises(
        FrontUnavailable, match=r"cannot tell this site's certificate: 127\.0\.0\.1"
    ):
        front.certificate("localhost")
