"""Certificates: self-signed at first, from a real ACME authority when there is a domain, the admin's own above all."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import processes
import pytest
from acme_network import DOMAIN, AcmeNetwork, make_certificate
from inside import run_inside
from nginx_alone import remove

HSTS = "strict-transport-security"
VALIDITY_S = 30
GOT = b"has a certificate until"
NOT_YET = b"renewal is not needed"
ASKED_TO = b"renewal is needed"
ALIVE = "/usr/lib/robotether/alive"


def let_in(folder: Path) -> Path:
    """Let the containers' users enter a folder."""
    for place in (folder, *folder.parents[:3]):
        place.chmod(place.stat().st_mode | 0o055)
    return folder


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder that the containers' users may enter."""
    return let_in(tmp_path)


@pytest.fixture
def network(folder: Path) -> Iterator[AcmeNetwork]:
    """nginx, acme and an authority whose certificates last an hour."""
    with AcmeNetwork(folder) as made:
        yield made


@pytest.fixture(scope="module")
def lonely(tmp_path_factory: pytest.TempPathFactory) -> Iterator[AcmeNetwork]:
    """A network without an authority, for tests that remove what they started."""
    with AcmeNetwork(let_in(tmp_path_factory.mktemp("lonely"))) as made:
        yield made


@pytest.mark.release
def test_a_certificate_is_got_and_served(network: AcmeNetwork) -> None:
    network.start_authority()
    nginx = network.start_nginx()
    assert HSTS not in network.wait_served(nginx, DOMAIN)
    acme = network.start_acme()
    assert network.wait_served(nginx, "*Pebble*", acme)[HSTS].startswith("max-age=")
    assert acme.exec_run(["/usr/lib/robotether/healthy"]).exit_code == 0


@pytest.mark.release
def test_a_short_lived_certificate_is_renewed_before_it_ends(folder: Path) -> None:
    """The next one is there while it still holds, though its life is half a minute."""
    with AcmeNetwork(folder, validity_s=VALIDITY_S) as network:
        network.start_authority()
        nginx = network.start_nginx()
        acme = network.start_acme()
        network.wait("a certificate", lambda: GOT in acme.logs(), acme)
        network.wait(
            "a second one",
            lambda: acme.logs().count(GOT) > 1,
            acme,
            seconds=VALIDITY_S,
        )
        network.wait_served(nginx, "*Pebble*", acme)


@pytest.mark.release
@pytest.mark.parametrize("days", [6, 90])
def test_a_certificate_is_renewed_when_the_authority_asks_for_it(folder: Path, days: int) -> None:
    """Not while it is new, however short its life is; at once when its renewal window (ARI) has begun."""
    with AcmeNetwork(folder, validity_s=days * 86400) as network:
        network.start_authority()
        network.wait_served(network.start_nginx(), DOMAIN)
        acme = network.start_acme()
        network.wait("a certificate", lambda: acme.logs().count(GOT) == 1, acme)
        acme.restart(timeout=1)
        network.wait("a look at its age", lambda: NOT_YET in acme.logs(), acme)
        assert acme.logs().count(GOT) == 1
        # What an authority says of a certificate that it had to revoke: renew at once.
        network.revoke(acme)
        acme.restart(timeout=1)
        network.wait("another certificate", lambda: acme.logs().count(GOT) == 2, acme)
        assert ASKED_TO in acme.logs()
        acme.restart(timeout=1)
        network.wait("a look at its age", lambda: acme.logs().count(NOT_YET) == 2, acme)
        assert acme.logs().count(GOT) == 2


@pytest.mark.release
def test_an_authority_that_is_away_keeps_nothing_from_starting(network: AcmeNetwork) -> None:
    """The self-signed certificate serves, the client is unhealthy and says why, and it gets there later."""
    nginx, acme = network.start_nginx(), network.start_acme()
    # lego itself tries for half a minute.
    network.wait("the failure", lambda: b"no certificate for" in acme.logs(), acme, seconds=60)
    assert acme.exec_run(["/usr/lib/robotether/healthy"]).exit_code != 0
    network.wait_served(nginx, DOMAIN)
    network.start_authority()
    network.wait_served(nginx, "*Pebble*", acme, seconds=60)


@pytest.mark.parametrize("domain", ["", "Robots.Example", "localhost", "-x.example", "a b.example"])
def test_a_wrong_domain_waits_for_a_person(lonely: AcmeNetwork, domain: str) -> None:
    """The sentence names the variable; Docker does not start it again and again."""
    acme = lonely.start_acme(domain)
    try:
        lonely.wait("the sentence", lambda: b"DOMAIN is" in acme.logs(), acme)
        acme.reload()
        assert acme.status == "running"
    finally:
        remove(acme)


@pytest.mark.release
def test_client_that_hangs_is_noticed(lonely: AcmeNetwork) -> None:
    """Also before it has a certificate; while it waits for the authority it says that it is alive."""
    acme = lonely.start_acme()
    try:
        lonely.wait("the first try", lambda: run_inside(acme, ALIVE).returncode == 0, acme)
        for pid in processes.matching(acme, ""):
            os.kill(pid, signal.SIGSTOP)
        lonely.wait("the hang", lambda: run_inside(acme, ALIVE).returncode != 0, acme, seconds=60)
    finally:
        remove(acme)


def test_the_admins_own_certificate_wins_and_is_followed(network: AcmeNetwork) -> None:
    """A new pair serves within seconds; a wrong one changes nothing, also after a restart, and nginx says why."""
    nginx = network.start_nginx()
    network.wait_served(nginx, DOMAIN)
    make_certificate(network.own, "own.example.test", DOMAIN)
    assert HSTS in network.wait_served(nginx, "own.example.test")
    (network.own / "key.pem").write_text("half a key")
    make_certificate(network.folder("next"), "next.example.test", DOMAIN)
    (network.own / "cert.pem").write_bytes((network.folder("next") / "cert.pem").read_bytes())
    network.wait("the reason", lambda: b"is not a private key in PEM" in nginx.logs(), nginx)
    nginx.restart(timeout=1)
    assert HSTS in network.wait_served(nginx, "own.example.test")
    (network.own / "key.pem").write_bytes((network.folder("next") / "key.pem").read_bytes())
    network.wait_served(nginx, "next.example.test")


def test_nginx_speaks_in_problems(lonely: AcmeNetwork) -> None:
    """Where no program answers, nginx's own answer has the headers of all others."""
    nginx = lonely.start_nginx()
    try:
        headers = lonely.wait_served(nginx, DOMAIN)
    finally:
        remove(nginx)
    assert headers["content-type"] == "application/problem+json"
    assert headers["content-security-policy"].startswith("default-src 'none'")
    assert headers["x-content-type-options"] == "nosniff"
