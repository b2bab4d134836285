"""What the one-shot service `secrets` makes of the files that a site has, and of none."""

import base64
import io
import json
import os
import tarfile
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path

import docker
import pytest
from commands import output_of_command
from cryptography import x509
from cryptography.x509.verification import PolicyBuilder, Store
from dated_certificate import make_certificate
from docker.models.containers import Container
from image_names import ensure_built, image
from inside import run_inside
from openssh_server import make_key
from secret_files import SECRETS_OF
from tls_front import openssl

ROOT = Path(__file__).resolve().parents[2]


# Prints the volume: folder, then file, then owner, mode and text.
LOOK = """
import json, pathlib
print(json.dumps({
    folder.name: {
        file.name: [file.stat().st_uid, file.stat().st_mode & 0o777, file.read_text()]
        for file in folder.iterdir()
    }
    for folder in pathlib.Path("/secrets").iterdir()
}))
"""


@pytest.fixture(scope="module", autouse=True)
def built():
    """The image, as it is in this checkout."""
    ensure_built("server")


@dataclass(frozen=True)
class Site:
    """A container with a volume, and a folder of secrets of one's own, that stays between runs of the service."""

    container: Container
    own: Path

    def make(self, database="mysql"):
        """Run the service's command, with the host of the database; status and what it printed."""
        done = run_inside(
            self.container, "make-secrets", environment={"DB_HOST": database}, merged=True
        )
        return done.returncode, done.stdout

    def export(self):
        """The secrets that the next machine gets: name -> text."""
        done = run_inside(self.container, "sh", "-c", "make-secrets export | base64")
        assert done.returncode == 0, done.stderr
        with tarfile.open(fileobj=io.BytesIO(base64.b64decode(done.stdout))) as archive:
            return {
                member.name: file.read().decode()
                for member in archive
                if (file := archive.extractfile(member)) is not None
            }

    def files(self):
        """What is in the volume: folder -> name -> owner, mode, text."""
        done = run_inside(self.container, "python3", stdin=LOOK)
        return json.loads(done.stdout)

    def texts(self):
        """What each service finds: folder -> name -> text."""
        return {
            folder: {name: text for name, (_, _, text) in files.items()}
            for folder, files in self.files().items()
            if folder in SECRETS_OF
        }


@contextmanager
def site_in(folder):
    own = folder / "own"
    own.mkdir(mode=0o700)
    container = docker.from_env().containers.run(
        image("server"), ["sleep", "infinity"], detach=True, read_only=True, network_mode="none",
        user="0:0", cap_drop=["ALL"], cap_add=["CHOWN", "DAC_OVERRIDE"], tmpfs={"/secrets": ""},
        volumes=[f"{own}:/own/secrets:ro"],
    )  # fmt: skip
    try:
        yield Site(container, own)
    finally:
        container.remove(force=True)


@pytest.fixture
def site(tmp_path):
    """A site that was never started."""
    with site_in(tmp_path) as made:
        yield made


def test_each_service_gets_its_own_secrets(site):
    """They are long, shared where needed, readable by one account, and unprinted; later starts keep them."""
    status, said = site.make()
    assert status == 0, said
    files = site.files()
    made = files.pop("made")
    assert {folder: set(found) for folder, found in files.items()} == SECRETS_OF
    assert {text for _, _, text in files.pop("alertmanager").values()} == {""}
    for folder in ("web", "migrate"):
        assert files[folder].pop("admin_password")[2] == ""
    assert len({text for _, _, text in made.values()}) == len(made)
    for found in files.values():
        for name, (owner, mode, text) in found.items():
            assert text == made[name][2]
            assert len(text) > 40
            assert text not in said
            assert (owner != 0, mode) == (True, 0o440)
    assert {mode for _, mode, _ in made.values()} == {0o600}
    owners = {name: owner for name, (owner, _, _) in files["sshd"].items()}
    assert owners.pop("session_key") not in owners.values()
    before = site.files()
    assert site.make() == (0, "")
    assert site.files() == before


def test_files_of_ones_own_win(site):
    """As a site has them from before; what is missing or empty among them is made."""
    site.make()
    for name, text in (
        ("ticket_key", "t" * 40),
        ("admin_password", "one-of-ones-own"),
        ("session_key", ""),
    ):
        (site.own / name).write_text(text)
        (site.own / name).chmod(0o600)
    assert site.make() == (0, "")
    texts = site.texts()
    assert texts["web"]["ticket_key"] == texts["relay"]["ticket_key"] == "t" * 40
    assert texts["web"]["admin_password"] == "one-of-ones-own"
    assert len(texts["relay"]["session_key"]) > 40


def names_in(certificate):
    read = x509.load_pem_x509_certificate(certificate.encode())
    found = read.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    return {str(item.value) for item in found}


def test_database_has_a_certificate_for_its_host(site):
    """Which the authority that all others get has signed; another host makes another one, of the same authority."""
    site.make()
    before = site.texts()
    assert names_in(before["mysql"]["database_cert.pem"]) == {"mysql", "localhost", "127.0.0.1"}
    said = site.make(database="192.0.2.7")[1]
    assert said == "secrets: made database_cert.pem\n"
    after = site.texts()
    assert "192.0.2.7" in names_in(after["mysql"]["database_cert.pem"])
    assert after["mysql"]["database_key.pem"] != before["mysql"]["database_key.pem"]
    authority = x509.load_pem_x509_certificate(before["web"]["database_ca.pem"].encode())
    [certificate] = x509.load_pem_x509_certificates(after["mysql"]["database_cert.pem"].encode())
    asked = x509.IPAddress(ip_address("192.0.2.7"))
    PolicyBuilder().store(Store([authority])).build_server_verifier(asked).verify(certificate, [])
    assert site.make(database="192.0.2.7") == (0, "")
    site.make(database="db1.example")
    assert "db1.example" in names_in(site.texts()["mysql"]["database_cert.pem"])


def test_next_machine_of_a_site_gets_the_same_secrets(site, tmp_path):
    """All but the first admin's password and the database's certificate, which it makes of the same authority."""
    (site.own / "ticket_key").write_text("t" * 40)
    site.make()
    shared = site.export()
    (tmp_path / "next").mkdir()
    with site_in(tmp_path / "next") as following:
        for name, text in shared.items():
            (following.own / name).write_text(text)
        host_key = following.own / "ssh_host_ed25519_key"
        make_key(host_key)
        assert following.make() == (0, "secrets: made database_cert.pem\n")
        texts, own = following.texts(), site.texts()
        assert texts["sshd"].pop("ssh_host_ed25519_key") == host_key.read_text()
        for name in ("database_cert.pem", "database_key.pem"):
            assert texts["mysql"].pop(name) != own["mysql"].pop(name)
        assert texts == own
        assert following.export() == shared


def test_a_site_that_nothing_runs_gets_its_secrets(tmp_path):
    """Swarm and Kubernetes get all that any service reads; a second run keeps each file."""
    folder = tmp_path / "site"
    made = []
    for _ in range(2):
        environ = {**os.environ, "ENV_FILE": "/dev/null"}
        output_of_command(ROOT / "tools" / "site_secrets", "--new", folder, env=environ)
        made.append({file.name: file.read_bytes() for file in folder.iterdir()})
    assert made[0] == made[1]
    assert all(made[0].values())
    more = {"database_ca_key.pem", "ssh_host_ed25519_key"}
    # Where alerts go is the site's own to say.
    of_all = set().union(*SECRETS_OF.values()) - SECRETS_OF["alertmanager"]
    assert set(made[0]) == of_all | more
    assert {file.stat().st_mode & 0o777 for file in folder.iterdir()} == {0o600}


def test_database_elsewhere_has_its_own_certificate(site):
    """Of its authority there is no key: nothing is made of it, and what was made before is gone."""
    site.make()
    authority = site.texts()["web"]["database_ca.pem"]
    (site.own / "database_ca.pem").write_text(f"{authority}# somebody else's\n")
    assert site.make() == (0, "")
    texts = site.texts()
    assert texts["web"]["database_ca.pem"].endswith("else's\n")
    assert {"database_cert.pem", "database_key.pem"}.isdisjoint(texts["mysql"])
    assert "database_ca_key.pem" not in site.export()


def test_half_a_pair_stops_the_start(site):
    """The other half, which was made, would not fit."""
    site.make()
    halves = {"peer_key.pem": "peer_cert.pem", "database_cert.pem": "database_key.pem"}
    for given, missing in halves.items():
        (site.own / given).write_text("half")
        status, said = site.make()
        assert status == 1
        assert f"cannot use your own {given}: {missing} is missing" in said
        (site.own / given).unlink()


@pytest.fixture
def pair(tmp_path):
    """A certificate for localhost that is good for a day, and its key."""
    now = datetime.now(UTC)
    both = make_certificate(tmp_path, now - timedelta(days=1), now + timedelta(days=1)).read_text()
    certificate, begin, key = both.partition("-----BEGIN PRIVATE KEY-----")
    return certificate, begin + key


def test_own_pair_is_tried_before_anything_is_made(site, pair):
    """MariaDB would not start with a wrong one, for ever."""
    certificate, key = pair
    good = {"cert": certificate, "key": key, "ca": certificate}
    other = openssl("genpkey", "-algorithm", "ed25519").decode()
    request = ("req", "-x509", "-newkey", "ed25519", "-noenc", "-subj", "/CN=ca")
    authority = openssl(*request, "-keyout", "/dev/null").decode()
    for wrong, why in (
        ({"cert": key}, "database_cert.pem: it is no certificate in PEM"),
        ({"key": certificate}, "database_key.pem: it is not a private key in PEM"),
        ({"key": other}, "database_key.pem: it is not the key of database_cert.pem"),
        ({"ca": authority}, "database_cert.pem: self-signed certificate"),
        ({}, "secrets: made"),
    ):
        for name, text in (good | wrong).items():
            (site.own / f"database_{name}.pem").write_text(text)
        status, said = site.make(database="localhost")
        assert status == (1 if wrong else 0)
        assert why in said
        assert (site.texts() == {}) == bool(wrong)


def test_wrong_secrets_of_ones_own_stop_the_start(site, pair):
    """Their services would start again and again, and say why in a log of their own at best."""
    certificate, key = pair
    named = ("-noenc", "-subj", "/CN=x", "-addext", "subjectAltName=DNS:robotether-peer")
    weak_key = site.own.parent / "weak.pem"
    weak = openssl("req", "-x509", "-newkey", "rsa:1024", *named, "-keyout", str(weak_key)).decode()
    authority = {"database_ca.pem": certificate}
    for wrong, why in (
        ({"ticket_key": "t" * 31}, "ticket_key: it must have at least 32 characters"),
        ({"session_key": "t" * 40 + " t"}, "session_key: it must have no space"),
        ({"mysql_web_password": "p$ssword-of-web"}, "mysql_web_password: it must have only letters"),
        ({"alert_webhook_url": "hooks.example/abc"}, "alert_webhook_url: it must be an http or https URL"),
        ({"ssh_host_ed25519_key": "half"}, "ssh_host_ed25519_key: it is not a private key"),
        ({"database_ca.pem": "half"}, "database_ca.pem: it is no certificate in PEM"),
        ({"database_ca_key.pem": key}, "database_ca_key.pem: database_ca.pem is missing"),
        (authority | {"database_ca_key.pem": weak_key.read_text()}, "it is not the key of database_ca.pem"),
        ({"peer_cert.pem": weak, "peer_key.pem": weak_key.read_text()}, "certificate key too weak"),
        # The cells of the site would not accept it, nor would programs that ask the database.
        (
            {"peer_cert.pem": certificate, "peer_key.pem": key},
            "cannot use your own peer_cert.pem: hostname mismatch",
        ),
        (
            authority | {"database_cert.pem": certificate, "database_key.pem": key},
            "cannot use your own database_cert.pem: hostname mismatch",
        ),
        (
            {"peer_cert.pem": certificate + certificate[:200], "peer_key.pem": key},
            "peer_cert.pem: it, or a certificate beside it, is damaged",
        ),
    ):  # fmt: skip
        for name, text in wrong.items():
            (site.own / name).write_text(text)
        status, said = site.make()
        assert (status, site.texts()) == (1, {})
        assert why in said
        for name in wrong:
            (site.own / name).unlink()
