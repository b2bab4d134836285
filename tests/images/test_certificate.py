"""A certificate of one's own is tried before it serves: by nginx, and by a client that knows what browsers know."""

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import docker
import pytest
from dated_certificate import make_certificate
from docker.models.containers import Container
from image_names import ensure_built, image
from inside import run_inside
from tls_front import openssl

HOST = "robots.example.org"
EC = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256")
RSA = ("-newkey", "rsa:2048")


@dataclass(frozen=True)
class Pairs:
    """Certificates and keys as people have them, each made when it is asked for."""

    folder: Path

    def __getitem__(self, name):
        return self.folder / name

    def self_signed(self, name, *options, key=EC):
        openssl(
            *("req", "-x509", *key, "-noenc", "-subj", f"/CN={HOST}", *options),
            *("-keyout", str(self[f"{name}.key"]), "-out", str(self[f"{name}.pem"])),
        )

    def sign(self, name, by, *options):
        """Write NAME.pem and NAME.key, signed by another pair here."""
        self.self_signed(
            name, *options, "-CA", str(self[f"{by}.pem"]), "-CAkey", str(self[f"{by}.key"])
        )

    def join(self, name, *parts):
        """Write NAME.pem of certificates in this order."""
        self[f"{name}.pem"].write_bytes(
            b"".join(self[f"{part}.pem"].read_bytes() for part in parts)
        )


def names(*given):
    """Options for a certificate with these names."""
    return ("-addext", "subjectAltName=" + ",".join(given))


NAMED = names(f"DNS:{HOST}")
AUTHORITY = ("-addext", "keyUsage=critical,keyCertSign")
MIDDLE = ("-addext", "basicConstraints=critical,CA:TRUE", *AUTHORITY)


@pytest.fixture(scope="module")
def pairs(tmp_path_factory):
    """A site's authority with an intermediate one, a good certificate, and those that failed."""
    made = Pairs(tmp_path_factory.mktemp("pairs"))
    made.self_signed("root", "-subj", "/CN=root", *AUTHORITY)
    made.sign("middle", "root", "-subj", "/CN=middle", *MIDDLE)
    made.sign("good", "middle", *NAMED)
    made.join("chain", "good", "middle", "root")
    made.sign("user", "root", "-subj", "/CN=user", "-addext", "basicConstraints=critical,CA:FALSE")
    made.sign("by_user", "user", *NAMED)
    made.join("unfit", "by_user", "user", "root")
    made.join("reversed", "root", "middle", "good")
    made.join("shuffled", "good", "root", "middle")
    made.self_signed("rsa", *NAMED, key=RSA)
    made.self_signed("wildcard", *names("DNS:*.example.org"))
    made.self_signed("address", *names("IP:192.0.2.7"))
    made.self_signed("other", *names("DNS:other.example"))
    made.self_signed("half_label", *names("DNS:rob*.example.org"))
    made.self_signed("nameless")
    made.self_signed("ed25519", *NAMED, key=("-newkey", "ed25519"))
    made.self_signed("small", *NAMED, key=("-newkey", "rsa:1024"))
    encipherment = ("-addext", "keyUsage=critical,keyEncipherment,dataEncipherment")
    made.self_signed("encipherment", *NAMED, *encipherment, key=RSA)
    made.self_signed("stapled", *NAMED, "-addext", "tlsfeature=status_request")
    made.sign("sha1", "root", *NAMED, "-sha1")
    for_clients = ("-addext", "extendedKeyUsage=clientAuth")
    made.self_signed("client", *NAMED, *for_clients)
    made.sign("upper", "root", "-subj", "/CN=upper", *MIDDLE, *for_clients)
    made.sign("lower", "upper", "-subj", "/CN=lower", *MIDDLE)
    made.sign("low", "lower", *NAMED)
    made.join("above", "low", "lower", "upper")
    made["glued.pem"].write_bytes(made["chain.pem"].read_bytes().replace(b"-\n-", b"--"))
    made.self_signed("numbers", *NAMED, "-pkeyopt", "ec_param_enc:explicit")
    for name, year in (("ended", 2020), ("later", 2090)):
        begin = datetime(year, 1, 1, tzinfo=UTC)
        both = make_certificate(made.folder, begin, begin + timedelta(days=365))
        both.rename(made[f"{name}.pem"])
    for kind, name in (("x509", "good.pem"), ("pkey", "good.key")):
        openssl(kind, "-in", str(made[name]), "-outform", "der", "-out", str(made[f"{name}.der"]))
    lock = ("-aes128", "-passout", "pass:secret", "-out", str(made["locked.key"]))
    openssl("pkey", "-in", str(made["good.key"]), *lock)
    made["half.pem"].write_bytes(made["good.pem"].read_bytes()[:300])
    made["folder"].mkdir()
    return made


@dataclass(frozen=True)
class Site:
    """A container with a volume of secrets, as compose's service `certificate` has them, that stays between runs."""

    pairs: Pairs
    container: Container

    def take(self, certificate, key, host=HOST):
        """Run the service's command with two files of `pairs`; empty: not set. Status, and what it printed."""
        given = [f"/pairs/{name}" if name else "/dev/null" for name in (certificate, key)]
        done = run_inside(
            self.container,
            *("sh", "-c", "ln -sfn $0 /own/cert.pem && ln -sfn $1 /own/key.pem && exec $2", *given),
            "/usr/lib/robotether/take-certificate",
            environment={"PUBLIC_HOST": host},
            merged=True,
        )
        return done.returncode, done.stdout

    def handed_over(self):
        """The certificate that nginx finds; empty: none."""
        return run_inside(self.container, "cat", "/secrets/nginx/cert.pem").stdout


@pytest.fixture(scope="module")
def site(pairs):
    """A site whose own certificate serves."""
    ensure_built("nginx")
    container = docker.from_env().containers.run(
        image("nginx"), entrypoint=["sleep", "infinity"], detach=True, read_only=True,
        network_mode="none", user="0:0", cap_drop=["ALL"], cap_add=["CHOWN", "DAC_OVERRIDE"],
        tmpfs={"/run/nginx": "", "/own": "", "/secrets": ""}, volumes=[f"{pairs.folder}:/pairs:ro"],
    )  # fmt: skip
    made = Site(pairs, container)
    assert made.take("chain.pem", "good.key") == (0, "")
    yield made
    container.remove(force=True)


REFUSED = [
    ("good.pem", "", HOST, "set both TLS_CERT_FILE and TLS_KEY_FILE"),
    ("good.pem.der", "good.key", HOST, "is in DER; nginx reads PEM"),
    ("good.pem", "good.key.der", HOST, "the key is in DER"),
    ("good.key", "good.key", HOST, "is no certificate in PEM"),
    ("good.pem", "good.pem", HOST, "is not a private key in PEM"),
    ("folder", "good.key", HOST, "is a folder"),
    ("half.pem", "good.key", HOST, "certificate 1 of the file is damaged"),
    ("good.pem", "locked.key", HOST, "has a password"),
    ("good.pem", "other.key", HOST, "the key is not the key of the certificate"),
    ("reversed.pem", "good.key", HOST, "own certificate is number 3 in the file, and must be the first"),
    ("shuffled.pem", "good.key", HOST, "certificate 2 of the file did not sign certificate 1"),
    ("unfit.pem", "by_user.key", HOST, "2 of the file may not sign certificate 1: invalid CA certificate"),
    ("other.pem", "other.key", HOST, f"another name than PUBLIC_HOST, {HOST}: it is for DNS:other.example"),
    ("good.pem", "good.key", "192.0.2.7", "another name than PUBLIC_HOST, 192.0.2.7"),
    ("half_label.pem", "half_label.key", HOST, "another name than PUBLIC_HOST"),
    ("nameless.pem", "nameless.key", HOST, "has no subjectAltName"),
    ("ed25519.pem", "ed25519.key", HOST, "no browser opens a site with this kind of key: ED25519"),
    ("small.pem", "small.key", HOST, "nginx cannot load it: ee key too small"),
    ("client.pem", "client.key", HOST, "is not for servers"),
    ("above.pem", "low.key", HOST, "is not for servers"),
    ("sha1.pem", "sha1.key", HOST, "certificate 1 of the file is signed with ecdsa-with-SHA1"),
    ("stapled.pem", "stapled.key", HOST, "demands OCSP stapling"),
    ("glued.pem", "good.key", HOST, "on one line"),
    ("encipherment.pem", "encipherment.key", HOST, "keyUsage has no digitalSignature"),
    ("numbers.pem", "numbers.key", HOST, "numbers of its curve"),
    ("ended.pem", "ended.pem", "localhost", "has ended"),
    ("later.pem", "later.pem", "localhost", "is not valid yet"),
]  # fmt: skip


def test_what_cannot_serve_is_refused_and_changes_nothing(site):
    for certificate, key, host, why in REFUSED:
        status, said = site.take(certificate, key, host)
        assert status == 1, why
        assert said.startswith("cannot use your own certificate: ")
        assert why in said
    assert site.handed_over() == site.pairs["chain.pem"].read_text()


def test_what_browsers_accept_is_handed_to_nginx(site):
    accepted = {"rsa": HOST, "wildcard": HOST, "address": "192.0.2.7", "other": ""}
    for name, host in accepted.items():
        assert site.take(f"{name}.pem", f"{name}.key", host) == (0, "")
        assert site.handed_over() == site.pairs[f"{name}.pem"].read_text()


def test_certificate_without_the_one_that_signed_it_serves_with_a_warning(site):
    """A file without its chain opens in some browsers alone; a site's own authority may be known everywhere."""
    status, said = site.take("good.pem", "good.key")
    assert status == 0
    assert "serves, but the file has no certificate of its signer (CN = middle)" in said
    assert site.handed_over() == site.pairs["good.pem"].read_text()


def test_certificate_is_taken_back(site):
    """Empty settings remove it, also where none is."""
    for _ in range(2):
        assert site.take("", "") == (0, "")
        assert site.handed_over() == ""
    assert site.take("chain.pem", "good.key") == (0, "")
