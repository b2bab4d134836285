"""The line that installs a robot, and the certificate that it pins."""

import base64
import hashlib
import shlex

import pytest
import tls_front
from local_network import free_port
from robotether_server.install_line import (
    CERTIFICATE_CACHE_S,
    MAX_CACHED,
    Certificate,
    SiteCertificates,
    enrolment_lines,
    parse_site_address,
)
from robotether_server.problems import FieldInvalidError, SiteCertificateUnavailableError
from robotether_server.settings.server import SiteAddressSettings
from tls_front import openssl

FINGERPRINT = "ab" * 32
PIN = "q83vEjRWeJA+/q83vEjRWeJAq83vEjRWeJAq83vEjRW="


class KnownCertificate(SiteCertificates):
    def __init__(self, host, port, *, is_known):
        super().__init__(SiteAddressSettings(host, port, ("nobody", 1)))
        self.given = Certificate(FINGERPRINT, PIN, is_known)

    def certificate(self, host):
        return self.given


def test_known_certificate_is_left_to_the_authorities():
    certificates = KnownCertificate("robots.example", 443, is_known=True)
    assert enrolment_lines(certificates, "10.0.0.1", "rj_abc").install == (
        "curl -fsS https://robots.example/join.sh | sudo sh -s -- --server robots.example --token rj_abc"
    )


@pytest.mark.parametrize(
    ("asked", "is_robot_itself"),
    [
        ("LOCALHOST:8443", True),
        ("web.localhost", True),
        ("127.1", True),
        ("0.0.0.0", True),
        ("[::ffff:127.0.0.1]:8443", True),
        ("10.0.0.1:8443", False),
        ("[2001:db8::1]", False),
        ("localhost.example", False),
    ],
)
def test_an_address_that_is_the_robot_itself_is_warned_of(asked, is_robot_itself):
    warning = enrolment_lines(KnownCertificate(None, 443, is_known=False), asked, "rj_abc").warning
    assert ("No robot can use this line" in warning) == is_robot_itself


def test_each_way_has_its_line():
    """All pin the certificate; the robot's name goes where it enrols itself; a token is one word."""
    certificates = KnownCertificate("2001:db8::1", 8443, is_known=False)
    token = "rj_$(reboot) '; x"
    assert shlex.split(enrolment_lines(certificates, "", token).install)[-1] == token
    lines = enrolment_lines(certificates, "", "rj_abc", "turtle")
    site = "'[2001:db8::1]:8443'"
    assert lines.install == (
        f"curl -fsSk --pinnedpubkey sha256//{PIN} 'https://[2001:db8::1]:8443/join.sh' | sudo sh -s -- "
        f"--server {site} --tls-fingerprint {FINGERPRINT} --name turtle --token rj_abc"
    )
    assert lines.package == (
        f"curl -fsSk --pinnedpubkey sha256//{PIN} -o agent.deb 'https://[2001:db8::1]:8443/agent.deb' "
        "&& sudo apt install ./agent.deb"
    )
    assert lines.containers == (
        f"SERVER={site} TLS_FINGERPRINT={FINGERPRINT} NAME=turtle TOKEN=rj_abc docker compose up -d"
    )
    assert lines.playbook == "ROBOTETHER_TOKEN=rj_abc ansible-playbook enroll.yml"


@pytest.mark.parametrize(
    "text", ["a b", "a;reboot", "$(x)", "a/b", "a:b", "::1", "u@a", "a\nb", ".a", "a" * 64]
)
def test_host_that_is_none_is_refused(text):
    """A header is a stranger's text until it is checked."""
    with pytest.raises(FieldInvalidError, match="cannot use host"):
        parse_site_address(text)


@pytest.fixture
def shown(tmp_path):
    with tls_front.running(tmp_path) as certificates:
        yield certificates


def certificates_of(shown, **options):
    return SiteCertificates(SiteAddressSettings(None, 443, shown.endpoint), **options)


def test_fingerprint_and_pin_are_those_of_openssl(shown):
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
def test_authorities_are_asked_for_a_name(shown, monkeypatch, host, is_known):
    """A certificate that is trusted under another name alone is not known."""
    monkeypatch.setenv("SSL_CERT_FILE", str(shown.certificate))
    assert certificates_of(shown).certificate(host).is_known == is_known


def test_certificates_are_kept_for_a_minute_and_bounded(shown):
    now = 1000.0
    certificates = certificates_of(shown, now=lambda: now)
    certificates.certificate("localhost")
    asked = shown.handshakes
    now += CERTIFICATE_CACHE_S - 1
    certificates.certificate("localhost")
    assert shown.handshakes == asked
    now += 2
    certificates.certificate("localhost")
    assert shown.handshakes == 2 * asked
    for number in range(MAX_CACHED + 2):
        certificates.certificate(f"host{number}.example")
    assert len(certificates._cached) <= MAX_CACHED


def test_no_certificate_is_said_so():
    certificates = SiteCertificates(SiteAddressSettings(None, 443, ("127.0.0.1", free_port())))
    with pytest.raises(
        SiteCertificateUnavailableError,
        match=r"cannot determine this site's certificate: 127\.0\.0\.1",
    ):
        certificates.certificate("localhost")
