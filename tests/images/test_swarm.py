"""A site on Docker Swarm: a node with the database, and two cells; as docs/howto/swarm.md says."""

import io
import json
import os
import re
import shlex
import ssl
import tarfile
import urllib.request
import uuid
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import TypeVar

import docker
import pytest
from commands import output_of_command
from docker.models.containers import Container
from docker.types import Mount
from docker_engine import address_of
from image_names import BUILD, ensure_built, image
from inside import run_inside
from local_network import insecure_tls
from openssh_server import wait_until

ROOT = Path(__file__).resolve().parents[2]
T = TypeVar("T")


@dataclass
class Node:
    name: str
    container: Container

    @property
    def address(self):
        self.container.reload()
        return address_of(self.container)

    def run(self, command, **environment):
        wanted = ("bash", "-ec", command)
        done = run_inside(self.container, *wanted, environment=environment, merged=True)
        assert done.returncode == 0, f"{command!r} on {self.name}: {done.stdout[-4000:]}"
        return done.stdout

    def succeeds(self, command):
        return run_inside(self.container, "bash", "-c", command).returncode == 0

    def inside(self, service, command):
        return self.run(f"docker exec $(docker ps --quiet --filter name={service}) {command}")

    def load(self, archive):
        inside = ("docker", "exec", "--interactive", str(self.container.id))
        with archive.open("rb") as stream:
            output_of_command(*inside, "docker", "load", "--quiet", stdin=stream, limit_s=300)


@dataclass
class Swarm:
    """Docker engines in containers, by name, the first of which is the manager; none has internet."""

    folder: Path
    secrets: Path
    names: tuple[str, ...]
    engine: docker.DockerClient = field(default_factory=docker.from_env)
    nodes: dict[str, Node] = field(default_factory=dict)

    def __enter__(self):
        output_of_command(BUILD, "docker_host", limit_s=300)
        self.prefix = f"swarm-test-{uuid.uuid4().hex[:8]}"
        self.network = self.engine.networks.create(self.prefix, driver="bridge")
        try:
            for name in self.names:
                self._boot(name)
            for node in self.nodes.values():
                self.wait(f"the engine of {node.name}", partial(node.succeeds, "docker info"))
            self._join()
        except BaseException:
            self._remove()
            raise
        return self

    def __exit__(self, *_):
        self._remove()

    @property
    def manager(self):
        return self.nodes[self.names[0]]

    def hand_over(self, node, *names):
        archive = self.folder / "images.tar"
        output_of_command("docker", "save", "--output", archive, *map(image, names), limit_s=300)
        self.nodes[node].load(archive)
        archive.unlink()

    def deploy(self, stack, *files, **settings):
        tag = image("server").partition(":")[2]
        named = " ".join(f"--compose-file /deploy/swarm/{file}" for file in files)
        # The engines would look for newer images in a registry.
        self.manager.run(
            f"docker stack deploy --detach=true --resolve-image never {named} {stack}",
            TAG=tag,
            **settings,
        )

    def states(self, stack):
        """Service -> what Swarm says of its replicas, such as 1/1."""
        listed = self.manager.run(
            f"docker stack services --format '{{{{.Name}}}} {{{{.Replicas}}}}' {stack}"
        )
        return dict(line.split(maxsplit=1) for line in listed.splitlines())

    def is_up(self, stack):
        states = self.states(stack)
        return bool(states) and all(
            state.startswith(("1/1", "0/1 (1/1 completed)")) for state in states.values()
        )

    def wait(self, what, condition, seconds=60):
        return wait_until(condition, lambda: f"{what}\n{self._report()}", seconds, every_s=0.5)

    def _report(self):
        if not self.nodes:
            return ""
        command = (
            "docker node ls;"
            "for stack in $(docker stack ls --format '{{.Name}}'); do docker stack ps --no-trunc $stack; done;"
            "for service in $(docker service ls --quiet); do docker service logs --tail 20 $service; done"
        )
        done = run_inside(self.manager.container, "bash", "-c", command, merged=True)
        return done.stdout[-12000:]

    def _boot(self, name):
        mounts = [
            Mount("/var/lib/docker", None, type="volume"),
            Mount("/deploy", str(ROOT / "deploy"), type="bind", read_only=True),
            Mount("/site-secrets", str(self.secrets), type="bind", read_only=True),
        ]
        container = self.engine.containers.run(
            image("docker_host"), detach=True, name=f"{self.prefix}-{name}", hostname=name,
            network=self.network.name, mounts=mounts, cap_add=["SYS_ADMIN", "NET_ADMIN", "SYS_PTRACE"],
            security_opt=["seccomp=unconfined"], cgroupns="host", tmpfs={"/run": ""},
            volumes={"/sys/fs/cgroup": {"bind": "/sys/fs/cgroup", "mode": "rw"}},
        )  # fmt: skip
        self.nodes[name] = Node(name, container)

    def _join(self):
        self.manager.run("docker swarm init --advertise-addr eth0")
        token = self.manager.run("docker swarm join-token --quiet worker").strip()
        for name in self.names[1:]:
            self.nodes[name].run(
                f"docker swarm join --token {shlex.quote(token)} {self.manager.address}:2377"
            )

    def _remove(self):
        for node in self.nodes.values():
            node.container.remove(force=True, v=True)
        self.network.remove()
        self.engine.close()


pytestmark = pytest.mark.release
CELLS = ("a", "b")


@pytest.fixture(scope="module")
def swarm(tmp_path_factory):
    """The whole site, without robots."""
    ensure_built("demo")
    folder = tmp_path_factory.mktemp("swarm")
    secrets = folder / "secrets"
    environ = {**os.environ, "ENV_FILE": "/dev/null"}
    output_of_command("tools/site_secrets", "--new", secrets, cwd=ROOT, env=environ)
    with Swarm(folder, secrets, ("database", *CELLS)) as running:
        running.hand_over("database", "mysql", "server")
        for cell in CELLS:
            running.hand_over(cell, "nginx", "server", "sshd")
            running.manager.run(f"docker node update --label-add robotether.cell={cell} {cell}")
        running.manager.run("docker node update --label-add robotether.database=true database")
        running.manager.run(
            "for file in /site-secrets/*; do docker secret create robotether_${file##*/} $file; done"
        )
        running.deploy("robotether", "database.yaml")
        for cell in CELLS:
            deploy_cell(running, cell)
        for stack in ("robotether", "robotether_a", "robotether_b"):
            running.wait(f"{stack} up", lambda stack=stack: running.is_up(stack), seconds=180)
        yield running


def deploy_cell(swarm, cell):
    swarm.deploy(
        f"robotether_{cell}", "cell.yaml", CELL=cell, PUBLIC_HOST=swarm.nodes[cell].address
    )


def ask(swarm, cell, path, token):
    url = f"https://{swarm.nodes[cell].address}{path}"
    request = urllib.request.Request(url, headers={"Authorization": f"Bearer {token}"})
    try:
        with urllib.request.urlopen(request, timeout=5, context=insecure_tls()) as answer:
            return bytes(answer.read())
    except OSError:
        return b""


def is_online(swarm, cell, token):
    answer = ask(swarm, cell, "/api/v1/robots/sim1", token)
    return bool(answer) and bool(json.loads(answer)["online"])


@contextmanager
def robot(swarm, cell, join_token):
    """A simulated robot that joins at a cell."""
    address = swarm.nodes[cell].address
    certificate = ssl.PEM_cert_to_DER_cert(ssl.get_server_certificate((address, 443)))
    files = {
        "agent.toml": f'tls_fingerprint = "{sha256(certificate).hexdigest()}"\n',
        "token": join_token,
    }
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w") as archive:
        for name, text in files.items():
            entry = tarfile.TarInfo(f"etc/robotether/{name}")
            entry.size, entry.mode = len(text), 0o644
            archive.addfile(entry, io.BytesIO(text.encode()))
    container = swarm.engine.containers.create(
        image("sim_robot"), name=f"{swarm.prefix}-sim1", hostname="sim1",
        network=swarm.network.name, mac_address="02:00:00:00:51:01",
        environment={
            "ROBOTETHER_SERVER": f"{address}:443",
            "ROBOTETHER_TOKEN_FILE": "/etc/robotether/token",
            "ROBOTETHER_INTERFACE": "eth0",
            "ROBOTETHER_ALLOW_LOCAL_MAC": "true",
            "SIM_NAME": "sim1",
        },
    )  # fmt: skip
    try:
        assert container.put_archive("/", packed.getvalue())
        container.start()
        yield container
    finally:
        container.remove(force=True, v=True)


def test_parts_of_a_cell_find_each_other(swarm):
    for cell in CELLS:
        address = swarm.nodes[cell].inside(f"robotether_{cell}_sshd", "hostname -i").split()
        found = swarm.nodes[cell].inside(f"robotether_{cell}_relay", "getent ahostsv4 sshd")
        assert {line.split()[0] for line in found.splitlines()} < set(address)


def test_robot_goes_to_the_next_cell(swarm):
    web = partial(swarm.nodes["a"].inside, "robotether_a_web")
    token = web("robotether token create --user admin --name test").split()[-1]
    line = web("robotether robot invite --uses 1 --hours 1 --host cloud")
    [join_token] = re.findall(r"--token (\S+)", line)
    web("robotether robot add sim1 --mac 02:00:00:00:51:01 --allow-local-mac")
    with robot(swarm, "a", join_token) as container:
        for cell in CELLS:
            swarm.wait(f"online at {cell}", lambda cell=cell: is_online(swarm, cell, token))
        swarm.manager.run("docker stack rm robotether_a")
        swarm.wait("gone from a", lambda: not ask(swarm, "a", "/login", token))
        try:
            swarm.wait("online at b alone", lambda: is_online(swarm, "b", token))
        except AssertionError as error:
            error.add_note(container.logs(tail=40).decode())
            raise
        sshd = swarm.nodes["b"].inside("robotether_b_sshd", "ps -u tunnel -o comm=")
        assert "session" in sshd


def test_node_comes_back_by_itself(swarm):
    """After a power cut of the machine of a cell, its services find each other again."""
    node = swarm.nodes["b"]
    node.container.kill()
    status = "docker node ls --filter name=b --format '{{.Status}}'"
    swarm.wait("lost", lambda: swarm.manager.run(status).strip() == "Down")
    node.container.start()
    swarm.wait("back", partial(ask, swarm, "b", "/login", ""), seconds=180)
