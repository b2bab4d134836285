"""A swarm of Docker engines, each in a container of its own: a manager for the shared part, and a node for each cell.

Nodes reach each other by address on a network of this machine; none has internet, so that images are handed over.
"""

from __future__ import annotations

import shlex
import uuid
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Self, TypeVar

import docker
from commands import output_of_command
from docker.models.containers import Container
from docker.types import Mount
from docker_engine import address_of
from image_names import BUILD, image
from inside import run_inside
from openssh_server import wait_until

ROOT = Path(__file__).resolve().parents[3]
T = TypeVar("T")


@dataclass
class Node:
    name: str
    container: Container

    @property
    def address(self) -> str:
        self.container.reload()
        return address_of(self.container)

    def run(self, command: str, **environment: str) -> str:
        wanted = ("bash", "-ec", command)
        done = run_inside(self.container, *wanted, environment=environment, merged=True)
        assert done.returncode == 0, f"{command!r} on {self.name}: {done.stdout[-4000:]}"
        return done.stdout

    def succeeds(self, command: str) -> bool:
        return run_inside(self.container, "bash", "-c", command).returncode == 0

    def inside(self, service: str, command: str) -> str:
        return self.run(f"docker exec $(docker ps --quiet --filter name={service}) {command}")

    def load(self, archive: Path) -> None:
        inside = ("docker", "exec", "--interactive", str(self.container.id))
        with archive.open("rb") as stream:
            output_of_command(*inside, "docker", "load", "--quiet", stdin=stream, limit_s=300)


@dataclass
class Swarm:
    """Nodes by name, the first of which is the manager; all are removed at the end."""

    folder: Path
    secrets: Path
    names: tuple[str, ...]
    engine: docker.DockerClient = field(default_factory=docker.from_env)
    nodes: dict[str, Node] = field(default_factory=dict)

    def __enter__(self) -> Self:
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

    def __exit__(self, *_: object) -> None:
        self._remove()

    @property
    def manager(self) -> Node:
        return self.nodes[self.names[0]]

    def hand_over(self, node: str, *names: str) -> None:
        archive = self.folder / "images.tar"
        output_of_command("docker", "save", "--output", archive, *map(image, names), limit_s=300)
        self.nodes[node].load(archive)
        archive.unlink()

    def deploy(self, stack: str, *files: str, **settings: str) -> None:
        tag = image("server").partition(":")[2]
        named = " ".join(f"--compose-file /deploy/swarm/{file}" for file in files)
        # The engines would look for newer images in a registry.
        self.manager.run(
            f"docker stack deploy --detach=true --resolve-image never {named} {stack}",
            TAG=tag,
            **settings,
        )

    def states(self, stack: str) -> dict[str, str]:
        """Service -> what Swarm says of its replicas, such as 1/1."""
        listed = self.manager.run(
            f"docker stack services --format '{{{{.Name}}}} {{{{.Replicas}}}}' {stack}"
        )
        return dict(line.split(maxsplit=1) for line in listed.splitlines())

    def is_up(self, stack: str) -> bool:
        states = self.states(stack)
        return bool(states) and all(
            state.startswith(("1/1", "0/1 (1/1 completed)")) for state in states.values()
        )

    def wait(self, what: str, condition: Callable[[], T], seconds: float = 60) -> T:
        return wait_until(condition, lambda: f"{what}\n{self._report()}", seconds, every_s=0.5)

    def _report(self) -> str:
        if not self.nodes:
            return ""
        command = (
            "docker node ls;"
            "for stack in $(docker stack ls --format '{{.Name}}'); do docker stack ps --no-trunc $stack; done;"
            "for service in $(docker service ls --quiet); do docker service logs --tail 20 $service; done"
        )
        done = run_inside(self.manager.container, "bash", "-c", command, merged=True)
        return done.stdout[-12000:]

    def _boot(self, name: str) -> None:
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

    def _join(self) -> None:
        self.manager.run("docker swarm init --advertise-addr eth0")
        token = self.manager.run("docker swarm join-token --quiet worker").strip()
        for name in self.names[1:]:
            self.nodes[name].run(
                f"docker swarm join --token {shlex.quote(token)} {self.manager.address}:2377"
            )

    def _remove(self) -> None:
        for node in self.nodes.values():
            node.container.remove(force=True, v=True)
        self.network.remove()
        self.engine.close()
