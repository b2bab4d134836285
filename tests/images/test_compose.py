"""What the running stack's containers are allowed and can reach, asked of the engine and from inside."""

import socket

import pytest
from commands import output_of_command
from image_names import image
from secret_files import SECRETS_OF

SERVICES = ("nginx", "web", "relay", "recorder", "sshd", "mysql")
SIMS = ("sim1", "sim2", "sim3")
ONE_SHOTS = ("settings", "secrets", "migrate", "demo")
# Beyond none: sshd changes to other accounts, and secrets gives the files of others away.
CAPABILITIES = {
    "sshd": {"CAP_SETUID", "CAP_SETGID", "CAP_SYS_CHROOT", "CAP_KILL"},
    "secrets": {"CAP_CHOWN", "CAP_DAC_OVERRIDE"},
}
SECRETS = {name: SECRETS_OF[name] for name in ("web", "relay", "recorder", "sshd", "mysql")}


def reached(stack, service, *addresses, seconds=5):
    """The addresses at which a TCP connection from inside a service's container opens in time; all at once."""
    script = " ".join(
        f"timeout {seconds:g} bash -c 'exec 3<>/dev/tcp/{host}/{port}' && echo {host} {port} &"
        for host, port in addresses
    )
    printed = stack.exec(service, "bash", "-c", f"({script} wait) 2>/dev/null")
    return {(host, int(port)) for host, port in map(str.split, printed.splitlines())}


def address(stack, service, network):
    """A container's address on one of the project's networks."""
    networks = stack.container(service).attrs["NetworkSettings"]["Networks"]
    return next(
        str(at["IPAddress"]) for name, at in networks.items() if name.endswith(f"_{network}")
    )


@pytest.mark.parametrize("service", SERVICES + SIMS + ONE_SHOTS)
def test_container_is_locked_down(stack, service):
    """Read-only, with the capabilities that it needs, bounded in memory and log; two alone are published."""
    host = stack.container(service).attrs["HostConfig"]
    assert host["ReadonlyRootfs"]
    assert not host["Privileged"]
    assert host["CapDrop"] == ["ALL"]
    added = {cap if cap.startswith("CAP_") else f"CAP_{cap}" for cap in host["CapAdd"] or []}
    assert added == CAPABILITIES.get(service, set())
    assert host["SecurityOpt"] == ["no-new-privileges:true"]
    assert host["Memory"] > 0
    log = host["LogConfig"]["Config"]
    assert (log["max-size"], log["mode"]) == ("10m", "non-blocking")
    published = {"nginx": {"8081/tcp", "8443/tcp"}, "sshd": {"2222/tcp"}}
    assert set(host["PortBindings"] or {}) == published.get(service, set())


@pytest.mark.parametrize("service", [*(s for s in SERVICES if s != "sshd"), *SIMS])
def test_container_runs_without_root(stack, service):
    """Only sshd, which must change accounts, runs as root."""
    assert stack.exec(service, "id", "-u").strip() != "0"


def test_secrets_are_made_out_of_reach(stack):
    """The one-shot service that runs as root has no network; the others are no root."""
    root = {
        service: stack.container(service).attrs["Config"]["User"] in {"", "0", "0:0"}
        for service in ONE_SHOTS
    }
    assert root == {"settings": False, "secrets": True, "migrate": False, "demo": False}
    assert stack.container("secrets").attrs["HostConfig"]["NetworkMode"] == "none"


def answers(host, port):
    """Whether this machine takes a connection to that port at one of its own addresses."""
    try:
        with socket.create_connection((host, port), timeout=5):
            return True
    except OSError:
        return False


def test_ports_are_published_over_ipv4_only(stack):
    """Docker's proxy would show all IPv6 clients as one address, which they would share in every limit."""
    for port in (stack.http_port, stack.https_port, stack.ssh_port):
        assert answers("127.0.0.1", port)
        assert not answers("::1", port)


def test_networks_are_as_designed(stack):
    """Who shares a network reaches the other, and nobody else does."""
    mysql, web, relay, sshd = ("mysql", 3306), ("web", 8000), ("relay", 8080), ("sshd", 2222)
    for service, reachable in {
        "web": {mysql},
        "relay": {sshd},
        "nginx": {web, relay},
        "sshd": {mysql},
    }.items():
        others = {"nginx": {mysql}, "sshd": {web}}.get(service, set())
        assert reached(stack, service, *reachable, *others) == reachable, service


def test_robot_reaches_the_published_ports_alone(stack):
    """A simulated robot is outside, as one behind NAT: no service and no other robot answers at its own address."""
    published = {("cloud", stack.ssh_port), ("cloud", stack.https_port)}
    inside = {
        (address(stack, "mysql", "data"), 3306),
        (address(stack, "web", "edge"), 8000),
        (address(stack, "relay", "tunnel"), 8091),
        (address(stack, "relay", "tunnel"), 9100),
        (address(stack, "sim2", "sim2"), 9090),
    }
    assert reached(stack, "sim1", *published, *inside, seconds=2) == published


def secrets_of(stack, service):
    """Name and hash of each secret that a service's container holds."""
    # The only root among them is in sshd, where it may not read what belongs to others.
    users = ("keylookup", "tunnel") if service == "sshd" else ("",)
    found = {}
    for user in users:
        look = "cd /run/secrets 2>/dev/null && sha256sum -- * 2>/dev/null || true"
        lines = stack.exec(service, "sh", "-c", look, user=user).splitlines()
        found |= {line.split()[1]: line.split()[0] for line in lines}
    return found


@pytest.mark.parametrize("service", SERVICES + SIMS)
def test_container_has_its_own_secrets_alone(stack, service):
    """No other folder of the volume is mounted, and in sshd each account reads one file."""
    assert set(secrets_of(stack, service)) == SECRETS.get(service, set())
    mounts = stack.container(service).attrs["HostConfig"]["Mounts"] or []
    folders = [
        mount["VolumeOptions"]["Subpath"]
        for mount in mounts
        if mount["Source"].endswith("_secrets")
    ]
    assert folders == [service] * (service in SECRETS or service == "nginx")
    if service == "sshd":
        for user, secret in (("keylookup", "session_key"), ("tunnel", "mysql_keylookup_password")):
            read = f"cat /run/secrets/{secret} 2>&1 || true"
            assert "Permission denied" in stack.exec("sshd", "sh", "-c", read, user=user)


def test_parts_are_good_and_what_needs_prometheus_is_unknown(stack):
    health = stack.admin.ask("GET", "/health")
    states = {part["name"]: part["state"] for part in health["parts"]}
    good = dict.fromkeys(("cell main", "recorder of main", "sshd"), "good")
    assert states.items() >= {**good, "prometheus": "unknown"}.items()


@pytest.mark.release
def test_second_start_changes_nothing(stack):
    """`tools/up` on a running stack keeps secrets, containers and robots."""
    password = stack.admin_password
    secrets = {service: secrets_of(stack, service) for service in SECRETS}
    containers = {service: stack.container(service).id for service in SERVICES + SIMS}
    stack.up()
    assert stack.admin_password == password
    assert {service: secrets_of(stack, service) for service in SECRETS} == secrets
    assert {service: stack.container(service).id for service in SERVICES + SIMS} == containers
    assert all(stack.online(sim) for sim in SIMS)


def test_no_secret_is_in_an_image():
    """The images' histories and environments hold no CA bundle and no generated secret."""
    for name in ("mysql", "sshd", "nginx", "acme", "prometheus", "server", "sim_robot"):
        inspect = ("docker", "image", "inspect", image(name), "--format", "{{json .Config}}")
        said = output_of_command(*inspect)
        assert "PASSWORD" not in said.upper().replace("PASSWORD_FILE", "")
        assert "/run/secrets/ca" not in said


@pytest.mark.release
def test_a_client_that_dies_in_a_transaction_keeps_no_lock(stack):
    locks = "START TRANSACTION; UPDATE users SET name = name;"
    died = f"(echo '{locks}'; sleep 60) | mariadb robotether"
    stack.container("mysql").exec_run(["sh", "-c", died], detach=True)
    holds = "SELECT 1 FROM information_schema.innodb_trx WHERE trx_rows_locked > 0"
    stack.wait("the lock", lambda: bool(stack.sql(holds)), "mysql")
    stack.sql("SET innodb_lock_wait_timeout = 30; UPDATE users SET name = name")
