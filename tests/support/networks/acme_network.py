"""nginx, acme and a real ACME authority (pebble) on a network of their own, without the rest of the stack.

Used by tests/images/test_acme.py. The host name leads to nginx by the engine's own DNS, and pebble asks it on nginx's
port 8081, since a container without root has no port 80.
"""

from __future__ import annotations

import json
import socket
import ssl
from collections.abc import Callable
from contextlib import ExitStack
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import Self

from commands import output_of_command
from docker.models.containers import Container
from image_names import ensure_built, image
from inside import run_inside
from local_network import insecure_tls
from nginx_alone import Containers, address_in
from openssh_server import wait_until

ROOT = Path(__file__).resolve().parents[3]
DOMAIN = "robots.example.test"
AUTHORITY = "authority"


class AcmeNetwork:
    """The three containers; `start_*` starts one, the `with` block's end removes all."""

    def __init__(self, folder: Path, *, validity_s: int = 3600) -> None:
        self._running = ExitStack()
        self._folder = folder
        self._validity_s = validity_s

    def __enter__(self) -> Self:
        _build_images()
        self._containers = Containers(self._running)
        self._network = self._containers.network()
        # Of certificates, challenges and acme's state.
        self._volumes = [self._containers.volume() for _ in range(3)]
        self._write_authority()
        (self._folder / "own").mkdir()
        return self

    def __exit__(self, *_: object) -> None:
        self._running.close()

    @property
    def own(self) -> Path:
        """The folder in which nginx looks for the admin's own certificate."""
        return self._folder / "own"

    def folder(self, name: str) -> Path:
        made = self._folder / name
        made.mkdir(exist_ok=True)
        return made

    def start_nginx(self) -> Container:
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

    def start_acme(self, domain: str = DOMAIN) -> Container:
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

    def revoke(self, acme: Container) -> None:
        settings = dict(entry.split("=", 1) for entry in acme.attrs["Config"]["Env"])
        command = ["lego", "--email", settings["ACME_EMAIL"], "--server", settings["ACME_SERVER"]]
        command += ["--domains", settings["DOMAIN"], "--path", "/var/lib/acme", "revoke", "--keep"]
        done = run_inside(
            acme, *command, environment={"LEGO_CA_CERTIFICATES": "/etc/robotether/acme-ca.pem"}
        )
        assert done.returncode == 0, done.stderr

    def start_authority(self) -> None:
        container = self._run(
            "pebble",
            AUTHORITY,
            volumes={str(self._folder / "pebble"): {"bind": "/etc/pebble", "mode": "ro"}},
        )
        self.wait("pebble listens", lambda: b"Listening on" in container.logs(), container)

    def served(self, nginx: Container) -> tuple[str, dict[str, str]]:
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
            assert der is not None
            request = f"GET /api/v1/robots HTTP/1.1\r\nHost: {DOMAIN}\r\nConnection: close\r\n\r\n"
            secure.sendall(request.encode())
            head = secure.recv(4096).decode().split("\r\n\r\n")[0].splitlines()
        headers = dict(line.lower().split(": ", 1) for line in head[1:])
        return issuer_of(ssl.DER_cert_to_PEM_cert(der)), headers

    def wait_served(
        self, nginx: Container, issuer: str, *containers: Container, seconds: float = 30
    ) -> dict[str, str]:
        """Wait until a certificate of this issuer serves, and return the headers of that very answer.

        The issuer may have wildcards, as in the shell.
        While nginx changes its certificate, the one before may serve once more, and a connection may be cut.
        """
        headers: dict[str, str] = {}

        def serves() -> bool:
            try:
                found, served_headers = self.served(nginx)
            except OSError:
                return False
            if fnmatchcase(found, issuer):
                headers.update(served_headers)
            return bool(headers)

        self.wait(f"{issuer}'s certificate", serves, nginx, *containers, seconds=seconds)
        return headers

    def wait(
        self, what: str, condition: Callable[[], bool], *containers: Container, seconds: float = 30
    ) -> None:
        def report() -> str:
            logs = (each.logs(tail=30, timestamps=True).decode() for each in containers)
            return "\n".join([what, *logs])

        wait_until(condition, report, seconds, every_s=0.2)

    def _run(self, built: str, *aliases: str, **options: object) -> Container:
        locked = {"cap_drop": ["ALL"], "read_only": True}
        return self._containers.start(self._network, image(built), *aliases, **locked, **options)

    def _write_authority(self) -> None:
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
def _build_images() -> None:
    ensure_built("nginx", "acme")
    # No site runs it.
    output_of_command(ROOT / "tools" / "build", "pebble", limit_s=900)


def make_certificate(folder: Path, name: str, *more: str) -> None:
    """Write cert.pem and key.pem for host names, signed by itself, readable by everybody."""
    command = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256"]
    command += ["-nodes", "-days", "2", "-subj", f"/CN={name}"]
    command += ["-addext", "subjectAltName=" + ",".join(f"DNS:{each}" for each in (name, *more))]
    command += ["-keyout", str(folder / "key.pem"), "-out", str(folder / "cert.pem")]
    output_of_command(*command)
    (folder / "key.pem").chmod(0o644)


def issuer_of(pem: str) -> str:
    command = ("openssl", "x509", "-noout", "-issuer", "-nameopt", "multiline")
    return output_of_command(*command, input=pem).partition("commonName")[2].strip(" =\n")
