"""A real MariaDB for tests: our own image in a throw-away container on a free port of 127.0.0.1."""

from __future__ import annotations

import hashlib
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import docker
from commands import output_of_command
from dated_certificate import make_certificate
from docker.errors import ImageNotFound
from docker.models.containers import Container
from inside import run_inside
from openssh_server import wait_until
from robotether_server.settings.server import DatabaseSettings

ROOT = Path(__file__).resolve().parents[3]
IMAGE_DIR = ROOT / "images" / "mysql"
# The base of all our images.
SUITE = "trixie"
ACCOUNTS = ("web", "relay", "recorder", "keylookup", "migrate")
HEALTHY_WITHIN_S = 90


@dataclass(frozen=True)
class MariaDb:
    container: Container
    port: int
    passwords: dict[str, str] = field(repr=False)
    # Its certificate, for localhost and 127.0.0.1: its own authority.
    certificate: Path

    def settings(self, account: str, ca_file: Path | None = None) -> DatabaseSettings:
        """How that account reaches the database: with an authority by TLS."""
        return DatabaseSettings(
            "127.0.0.1", self.port, "robotether", account, self.passwords[account], ca_file
        )

    def as_root(self, sql: str) -> str:
        command = ["mariadb", "--batch", "--skip-column-names", "--execute", sql, "robotether"]
        done = run_inside(self.container, *command)
        assert done.returncode == 0, done.stderr
        return done.stdout


def image(suite: str = SUITE) -> str:
    """The tag of the image of these sources, which is built when it is missing.

    On an older Debian than the Dockerfile's own it is an older MariaDB.
    """
    digest = hashlib.sha256(suite.encode())
    for path in sorted(IMAGE_DIR.iterdir()):
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    tag = f"robotether-test/mysql:{digest.hexdigest()[:16]}"
    with engine() as docker_engine:
        try:
            docker_engine.images.get(tag)
        except ImageNotFound:
            _build(tag, suite)
    return tag


@contextmanager
def engine() -> Iterator[docker.DockerClient]:
    client = docker.from_env()
    try:
        yield client
    finally:
        client.close()


@contextmanager
def running(folder: Path) -> Iterator[MariaDb]:
    """A server with its own secrets and empty volume, as unprivileged as in compose.yaml."""
    passwords = {account: secrets.token_urlsafe(24) for account in ACCOUNTS}
    write_secrets(folder, passwords)
    certificate = write_certificate(folder)
    with engine() as docker_engine:
        container = start(docker_engine, folder)
        try:
            wait_healthy(container)
            port = container.attrs["NetworkSettings"]["Ports"]["3306/tcp"][0]["HostPort"]
            yield MariaDb(container, int(port), passwords, certificate)
        finally:
            container.remove(force=True, v=True)


def write_secrets(folder: Path, passwords: dict[str, str]) -> None:
    folder.chmod(0o755)  # the container's user is another one
    for account, password in passwords.items():
        file = folder / f"mysql_{account}_password"
        file.write_text(password)
        file.chmod(0o644)


def write_certificate(folder: Path) -> Path:
    both = make_certificate(folder)
    for name in ("database_cert.pem", "database_key.pem"):
        (folder / name).write_bytes(both.read_bytes())
        (folder / name).chmod(0o644)
    return folder / "database_cert.pem"


def start(
    docker_engine: docker.DockerClient,
    folder: Path,
    volume: str | None = None,
    *,
    suite: str = SUITE,
) -> Container:
    volumes = {str(folder): {"bind": "/run/secrets", "mode": "ro"}}
    if volume:
        volumes[volume] = {"bind": "/var/lib/mysql", "mode": "rw"}
    return docker_engine.containers.run(  # type: ignore[call-overload] # no port: a free one
        image(suite),
        name=f"robotether-test-mysql-{os.getpid()}-{secrets.token_hex(4)}",
        detach=True,
        read_only=True,
        cap_drop=["ALL"],
        security_opt=["no-new-privileges:true"],
        mem_limit="512m",
        tmpfs={"/run/mysqld": "", "/tmp": ""},
        volumes=volumes,
        ports={"3306/tcp": ("127.0.0.1", None)},
    )


def wait_healthy(container: Container) -> None:
    def is_healthy() -> bool:
        container.reload()
        assert container.status != "exited", report()
        return container.attrs["State"].get("Health", {}).get("Status") == "healthy"

    def report() -> str:
        return f"MariaDB healthy:\n{container.logs(tail=60).decode(errors='replace')}"

    wait_until(is_healthy, report, HEALTHY_WITHIN_S, every_s=0.1)


def _build(tag: str, suite: str) -> None:
    """Build with BuildKit, which the engine's SDK does not speak."""
    base = f"debian:{SUITE}-slim=docker-image://debian:{suite}-slim"
    command = ("docker", "buildx", "build", "--load", "--build-context", base, "--tag", tag)
    output_of_command(*command, IMAGE_DIR, limit_s=900)
