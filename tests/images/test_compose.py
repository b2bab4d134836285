"""What the running stack's containers are allowed and can reach, asked of the engine and from inside."""

from __future__ import annotations

import socket
import subprocess

import pytest
from stack import ROOT, Stack

SERVICES = ("nginx", "web", "relay", "sshd", "mysql")
SIMS = ("sim1", "sim2", "sim3")


def reaches(stack: Stack, service: str, host: str, port: int, seconds: float = 5) -> bool:
    """Whether a TCP connection from inside a service's container opens in time."""
    script = f"timeout {seconds:g} bash -c 'exec 3<>/dev/tcp/{host}/{port}' && echo yes || echo no"
    return "yes" in stack.exec(service, "bash", "-c", f"({script}) 2>/dev/null")


def address(stack: Stack, service: str, network: str) -> str:
    """A container's address on one of the project's networks."""
    networks = stack.container(service).attrs["NetworkSettings"]["Networks"]
    return next(
        str(at["IPAddress"]) for name, at in networks.items() if name.endswith(f"_{network}")
    )


@pytest.mark.parametrize("service", SERVICES + SIMS)
def test_container_is_locked_down(stack: Stack, service: str) -> None:
    """Read-only, without capabilities but those that sshd needs, bounded in memory, processes and log."""
    host = stack.container(service).attrs["HostConfig"]
    assert host["ReadonlyRootfs"]
    assert not host["Privileged"]
    assert host["CapDrop"] == ["ALL"]
    allowed = (
        {"CAP_SETUID", "CAP_SETGID", "CAP_SYS_CHROOT", "CAP_KILL"} if service == "sshd" else set()
    )
    assert {
        cap if cap.startswith("CAP_") else f"CAP_{cap}" for cap in host["CapAdd"] or []
    } == allowed
    assert host["SecurityOpt"] == ["no-new-privileges:true"]
    assert host["Memory"] > 0
    assert host["LogConfig"]["Config"]["max-size"] == "10m"


@pytest.mark.parametrize("service", [*(s for s in SERVICES if s != "sshd"), *SIMS])
def test_container_runs_without_root(stack: Stack, service: str) -> None:
    """Only sshd, which must change accounts, runs as root."""
    assert stack.exec(service, "id", "-u").strip() != "0"


@pytest.mark.parametrize("service", SERVICES + SIMS)
def test_only_nginx_and_sshd_are_published(stack: Stack, service: str) -> None:
    """Every other service is reachable inside only."""
    bindings = stack.container(service).attrs["HostConfig"]["PortBindings"] or {}
    published = {"nginx": {"8080/tcp", "8443/tcp"}, "sshd": {"2222/tcp"}}
    assert set(bindings) == published.get(service, set())


def answers(host: str, port: int) -> bool:
    """Whether this machine takes a connection to that port at one of its own addresses."""
    try:
        with socket.create_connection((host, port), timeout=5):
            return True
    except OSError:
        return False


@pytest.mark.parametrize("name", ["http_port", "https_port", "ssh_port"])
def test_ports_are_published_over_ipv4_only(stack: Stack, name: str) -> None:
    """Docker's proxy would show all IPv6 clients as one address, which they would share in every limit."""
    port = getattr(stack, name)
    assert answers("127.0.0.1", port)
    assert not answers("::1", port)


@pytest.mark.parametrize(
    ("service", "host", "port", "expected"),
    [
        ("web", "mysql", 3306, True),
        ("relay", "sshd", 2222, True),
        ("nginx", "mysql", 3306, False),
        ("nginx", "web", 8000, True),
        ("nginx", "relay", 8080, True),
    ],
)
def test_networks_are_as_designed(
    stack: Stack, service: str, host: str, port: int, expected: bool
) -> None:
    """Who shares a network reaches the other, and nobody else does."""
    assert reaches(stack, service, host, port) is expected


@pytest.mark.parametrize(
    ("service", "network", "port"),
    [
        ("mysql", "data", 3306),
        ("web", "edge", 8000),
        ("relay", "tunnel", 8091),
        ("relay", "tunnel", 9100),
    ],
)
def test_robot_reaches_nothing_behind_the_published_ports(
    stack: Stack, service: str, network: str, port: int
) -> None:
    """A simulated robot is outside: no service answers it at its own address."""
    assert not reaches(stack, "sim1", address(stack, service, network), port, seconds=2)


def test_robots_do_not_reach_each_other(stack: Stack) -> None:
    """Each simulated robot is alone on its network."""
    assert not reaches(stack, "sim1", address(stack, "sim2", "sim2"), 9090, seconds=2)


def test_robot_reaches_the_published_ports(stack: Stack) -> None:
    """What a robot behind NAT reaches, a simulated one reaches."""
    assert reaches(stack, "sim1", "cloud", stack.ssh_port)
    assert reaches(stack, "sim1", "cloud", stack.https_port)


def test_secrets_are_kept_from_other_people(stack: Stack) -> None:
    """The folder is its owner's alone, and so is the admin's password."""
    secrets = stack.folder / "secrets"
    assert secrets.stat().st_mode & 0o777 == 0o700
    assert (secrets / "admin_password").stat().st_mode & 0o777 == 0o600


def secrets_of(stack: Stack) -> dict[str, str]:
    """Each generated file with what it holds."""
    files = (stack.folder / "secrets").rglob("*")
    return {file.name: file.read_text() for file in files if file.is_file()}


def test_second_start_changes_nothing(stack: Stack) -> None:
    """`tools/up --demo` on a running stack keeps secrets, containers and robots."""
    secrets = secrets_of(stack)
    containers = {service: stack.container(service).id for service in SERVICES + SIMS}
    stack.tool("tools/up", "--demo", timeout=300)
    assert secrets_of(stack) == secrets
    assert {service: stack.container(service).id for service in SERVICES + SIMS} == containers
    assert all(stack.online(sim) for sim in SIMS)


def test_no_secret_is_in_an_image() -> None:
    """The images' histories and environments hold no CA bundle and no generated secret."""
    for image in ("mysql", "sshd", "nginx", "acme", "server", "sim_robot"):
        done = subprocess.run(
            ["docker", "image", "inspect", f"robotether/{image}:dev", "--format", "{{json .Config}}"],
            capture_output=True, text=True, check=True, cwd=ROOT,
        )  # fmt: skip
        assert "PASSWORD" not in done.stdout.upper().replace("PASSWORD_FILE", "")
        assert "/run/secrets/ca" not in done.stdout
