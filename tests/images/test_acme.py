"""Certificates: self-signed at first, from a real ACME authority when there is a domain, the admin's own above all."""

import json
import os
import signal
import socket
import ssl
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path

import processes
import pytest
from commands import output_of_command
from image_names import ensure_built, image
from inside import run_inside
from local_network import insecure_tls
from nginx_alone import Containers, address_in, remove
from openssh_server import wait_until
from tls_front import make_pair

ROOT = Path(__file__).resolve().parents[2]
DOMAIN = "robots.example.test"
AUTHORITY = "authority"


class AcmeNetwork:
    """nginx, acme and a real authority (pebble), which asks nginx's port 8081: without root there is no port 80."""

    def __init__(self, folder, *, validity_s=3600):
        self._containers = Containers()
        self._folder = folder
        self._validity_s = validity_s

    def __enter__(self):
        _build_images()
        self._network = self._containers.network()
        # Of certificates, challenges and acme's state.
        self._volumes = [self._containers.volume() for _ in range(3)]
        self._write_authority()
        (self._folder / "own").mkdir()
        return self

    def __exit__(self, *_):
        self._containers.close()

    @property
    def own(self):
        """The folder in which nginx looks for the admin's own certificate."""
        return self._folder / "own"

    def folder(self, name):
        made = self._folder / name
        made.mkdir(exist_ok=True)
        return made

    def start_nginx(self):
        return self._run(
            "nginx",
            DOMAIN,
            environment={"PUBLIC_HOST": DOMAIN},
            volumes={
                self._volumes[0].name: {"bind": "/etc/nginx/acme", "mode": "ro"},
                self._volumes[1].name: {"bind": "/var/lib/acme-challenge", "mode": "ro"},
                str(self.own): {"bind": "/etc/nginx/own", "mode": "ro"},
            },
        )

    def start_acme(self, domain=DOMAIN):
        return self._run(
            "acme",
            environment={
                "DOMAIN": domain,
                "ACME_EMAIL": "admin@example.test",
                "ACME_SERVER": f"https://{AUTHORITY}:14000/dir",
            },
            volumes={
                self._volumes[0].name: {"bind": "/etc/nginx/acme", "mode": "rw"},
                self._volumes[1].name: {"bind": "/var/lib/acme-challenge", "mode": "rw"},
                self._volumes[2].name: {"bind": "/var/lib/acme", "mode": "rw"},
                str(self._folder / "pebble" / "cert.pem"): {
                    "bind": "/etc/robotether/acme-ca.pem",
                    "mode": "ro",
                },
            },
            tmpfs={"/tmp": ""},
        )

    def revoke(self, acme):
        settings = dict(entry.split("=", 1) for entry in acme.attrs["Config"]["Env"])
        command = ["lego", "--email", settings["ACME_EMAIL"], "--server", settings["ACME_SERVER"]]
        command += ["--domains", settings["DOMAIN"], "--path", "/var/lib/acme", "revoke", "--keep"]
        done = run_inside(
            acme, *command, environment={"LEGO_CA_CERTIFICATES": "/etc/robotether/acme-ca.pem"}
        )
        assert done.returncode == 0, done.stderr

    def start_authority(self):
        container = self._run(
            "pebble",
            AUTHORITY,
            volumes={str(self._folder / "pebble"): {"bind": "/etc/pebble", "mode": "ro"}},
        )
        self.wait("pebble listens", lambda: b"Listening on" in container.logs(), container)

    def served(self, nginx):
        """The issuer of the certificate that serves, and the headers of an answer of nginx's own."""
        with (
            socket.create_connection((address_in(self._network, nginx), 8443), timeout=5) as plain,
            # The handshake inside the block: a reload of nginx may cut it, and then nobody else would close the socket.
            insecure_tls().wrap_socket(
                plain, server_hostname=DOMAIN, do_handshake_on_connect=False
            ) as secure,
        ):
            secure.do_handshake()
            der = secure.getpeercert(binary_form=True)
            request = f"GET /api/v1/robots HTTP/1.1\r\nHost: {DOMAIN}\r\nConnection: close\r\n\r\n"
            secure.sendall(request.encode())
            head = secure.recv(4096).decode().split("\r\n\r\n")[0].splitlines()
        headers = dict(line.lower().split(": ", 1) for line in head[1:])
        return issuer_of(ssl.DER_cert_to_PEM_cert(der)), headers

    def wait_served(self, nginx, issuer, *containers, seconds=30):
        """Wait until a certificate of this issuer serves, and return the headers of that very answer.

        The issuer may have wildcards, as in the shell.
        While nginx changes its certificate, the one before may serve once more, and a connection may be cut.
        """
        headers = {}

        def serves():
            try:
                found, served_headers = self.served(nginx)
            except OSError:
                return False
            if fnmatchcase(found, issuer):
                headers.update(served_headers)
            return bool(headers)

        self.wait(f"{issuer}'s certificate", serves, nginx, *containers, seconds=seconds)
        return headers

    def wait(self, what, condition, *containers, seconds=30):
        def report():
            logs = (each.logs(tail=30, timestamps=True).decode() for each in containers)
            return "\n".join([what, *logs])

        wait_until(condition, report, seconds, every_s=0.2)

    def _run(self, built, *aliases, **options):
        locked = {"cap_drop": ["ALL"], "read_only": True}
        return self._containers.start(self._network, image(built), *aliases, **locked, **options)

    def _write_authority(self):
        place = self._folder / "pebble"
        place.mkdir()
        make_certificate(place, AUTHORITY)
        settings = {
            "listenAddress": "0.0.0.0:14000",
            "managementListenAddress": "0.0.0.0:15000",
            "certificate": "/etc/pebble/cert.pem",
            "privateKey": "/etc/pebble/key.pem",
            "httpPort": 8081,
            "tlsPort": 8443,
            "ocspResponderURL": "",
            "externalAccountBindingRequired": False,
            "certificateValidityPeriod": self._validity_s,
        }
        (place / "pebble.json").write_text(json.dumps({"pebble": settings}))


@cache
def _build_images():
    ensure_built("nginx", "acme")
    # No site runs it.
    output_of_command(ROOT / "tools" / "build", "pebble", limit_s=900)


def make_certificate(folder, name, *more):
    """Write cert.pem and key.pem for host names, signed by itself, readable by everybody."""
    names = "subjectAltName=" + ",".join(f"DNS:{each}" for each in (name, *more))
    make_pair(folder / "cert.pem", folder / "key.pem", name, "-addext", names)
    (folder / "key.pem").chmod(0o644)


def issuer_of(pem):
    command = ("openssl", "x509", "-noout", "-issuer", "-nameopt", "multiline")
    return output_of_command(*command, input=pem).partition("commonName")[2].strip(" =\n")


HSTS = "strict-transport-security"
VALIDITY_S = 30
GOT = b"has a certificate until"
NOT_YET = b"renewal is not needed"
ASKED_TO = b"renewal is needed"
ALIVE = "/usr/lib/robotether/alive"


def let_in(folder):
    """Let the containers' users enter a folder."""
    for place in (folder, *folder.parents[:3]):
        place.chmod(place.stat().st_mode | 0o055)
    return folder


@pytest.fixture
def folder(tmp_path):
    """A folder that the containers' users may enter."""
    return let_in(tmp_path)


@pytest.fixture
def network(folder):
    """nginx, acme and an authority whose certificates last an hour."""
    with AcmeNetwork(folder) as made:
        yield made


@pytest.fixture(scope="module")
def lonely(tmp_path_factory):
    """A network without an authority, for tests that remove what they started."""
    with AcmeNetwork(let_in(tmp_path_factory.mktemp("lonely"))) as made:
        yield made


@pytest.mark.release
def test_a_certificate_is_got_and_served(network):
    network.start_authority()
    nginx = network.start_nginx()
    assert HSTS not in network.wait_served(nginx, DOMAIN)
    acme = network.start_acme()
    assert network.wait_served(nginx, "*Pebble*", acme)[HSTS].startswith("max-age=")
    assert acme.exec_run(["/usr/lib/robotether/healthy"]).exit_code == 0


@pytest.mark.release
def test_a_short_lived_certificate_is_renewed_before_it_ends(folder):
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
def test_a_certificate_is_renewed_when_the_authority_asks_for_it(folder, days):
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
def test_an_authority_that_is_away_keeps_nothing_from_starting(network):
    """The self-signed certificate serves, the client is unhealthy and says why, and it gets there later."""
    nginx, acme = network.start_nginx(), network.start_acme()
    # lego itself tries for half a minute.
    network.wait("the failure", lambda: b"no certificate for" in acme.logs(), acme, seconds=60)
    assert acme.exec_run(["/usr/lib/robotether/healthy"]).exit_code != 0
    network.wait_served(nginx, DOMAIN)
    network.start_authority()
    network.wait_served(nginx, "*Pebble*", acme, seconds=60)


@pytest.mark.parametrize("domain", ["", "Robots.Example", "localhost", "-x.example", "a b.example"])
def test_a_wrong_domain_waits_for_a_person(lonely, domain):
    """The sentence names the variable; Docker does not start it again and again."""
    acme = lonely.start_acme(domain)
    try:
        lonely.wait("the sentence", lambda: b"DOMAIN is" in acme.logs(), acme)
        acme.reload()
        assert acme.status == "running"
    finally:
        remove(acme)


@pytest.mark.release
def test_client_that_hangs_is_noticed(lonely):
    """Also before it has a certificate; while it waits for the authority it says that it is alive."""
    acme = lonely.start_acme()
    try:
        lonely.wait("the first try", lambda: run_inside(acme, ALIVE).returncode == 0, acme)
        for pid in processes.matching(acme, ""):
            os.kill(pid, signal.SIGSTOP)
        lonely.wait("the hang", lambda: run_inside(acme, ALIVE).returncode != 0, acme, seconds=60)
    finally:
        remove(acme)


def test_the_admins_own_certificate_wins_and_is_followed(network):
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


def test_nginx_speaks_in_problems(lonely):
    """Where no program answers, nginx's own answer has the headers of all others."""
    nginx = lonely.start_nginx()
    try:
        headers = lonely.wait_served(nginx, DOMAIN)
    finally:
        remove(nginx)
    assert headers["content-type"] == "application/problem+json"
    assert headers["content-security-policy"].startswith("default-src 'none'")
    assert headers["x-content-type-options"] == "nosniff"
