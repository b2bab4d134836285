"""A site of several cells on this machine, each a compose project of its own, as the experiments reach and hurt it.

The first cell has the database. All cells are reached by published ports of one address, as from outside.
"""

from __future__ import annotations

import os
import socket
import struct
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from signal import SIGCONT, SIGSTOP, Signals
from typing import TYPE_CHECKING, Any

from cells import first_cell, second_cell
from commands import output_of_command, run_command
from inside import run_inside
from local_network import request_json
from openssh_server import words_of_all

from paper.world import World

if TYPE_CHECKING:
    from docker.models.containers import Container
    from stack import Stack

# Those of a cell, without the database.
SERVICES = ("nginx", "web", "relay", "sshd")
# They reach the database.
OF_DATABASE = ("web", "relay", "sshd")
# They reach other cells.
OF_PEERS = ("nginx", "relay")
DATABASE_PORT = 3306
# Of web and of the relay, which both answer 401 to who shows nothing.
HEALTH_PATHS = ("/api/v1/me", "/api/v1/events")
HEALTHY_WITHIN_S, ASK_EVERY_S = 120.0, 0.2
ORDERED_WITHIN_S = 30.0
# What gives web and relay a clock of their own, and the image that has the library for it.
CLOCK = Path(__file__).with_name("clock")
CLOCK_IMAGE, OFFSET = "robotether-test/clock", "offset"
NS_PER_S = 1e9
AT_ONCE = 4


@dataclass
class Cell:
    name: str
    stack: Stack
    # HOST of all of them.
    host: str

    @property
    def address(self) -> str:
        return f"{self.host}:{self.stack.https_port}"

    @property
    def ssh_ports(self) -> tuple[int, int]:
        return self.stack.ssh_port, self.stack.https_port

    @property
    def peer_port(self) -> int:
        return int(str(self.stack.settings["PEER_PORT"]))

    def container(self, service: str) -> Container:
        return self.stack.container(service)

    def each(self, services: Sequence[str], do: str, **how: Any) -> None:
        """Do the same with several containers at once; one that is so already stays."""
        with ThreadPoolExecutor(AT_ONCE) as threads:
            list(threads.map(lambda service: self._do(service, do, how), services))

    def _do(self, service: str, do: str, how: dict[str, Any]) -> None:
        container = self.container(service)
        is_running = container.status == "running"
        if do in ("pause", "unpause"):
            if is_running:
                _signal(container, SIGSTOP if do == "pause" else SIGCONT)
        elif {"kill": is_running, "start": not is_running}.get(do, True):
            getattr(container, do)(**how)

    def order(self, order: str) -> None:
        end = time.monotonic() + ORDERED_WITHIN_S
        command = ("robotether", "cell", order, self.name)
        # No cell is drained while no other is in service, and one that has just come back is not yet for a second.
        while (done := run_inside(self.container("web"), *command)).returncode != 0:
            if time.monotonic() > end:
                raise RuntimeError(f"cannot {order} cell {self.name}: {done.stderr[-2000:]}")
            time.sleep(ASK_EVERY_S)

    def step_clock(self, seconds: float) -> None:
        """Let the clock of web and relay differ from this machine's by so much."""
        folder = Path(str(self.stack.settings["STEPPED_CLOCK"]))
        # In place: they have it mapped.
        with (folder / OFFSET).open("r+b") as file:
            file.write(offset_bytes(seconds))

    def wait_live(self) -> None:
        what = f"cell {self.name} is back"
        self.stack.wait(what, self.is_live, *SERVICES, seconds=HEALTHY_WITHIN_S)

    def is_live(self) -> bool:
        return self._has_sshd() and all(self._status(path) == 401 for path in HEALTH_PATHS)

    def _has_sshd(self) -> bool:
        try:
            with socket.create_connection((self.host, self.ssh_ports[0]), timeout=2) as connection:
                connection.settimeout(2)
                return connection.recv(4) == b"SSH-"
        except OSError:
            return False

    def _status(self, path: str) -> int:
        try:
            return request_json("GET", f"https://{self.address}{path}", timeout_s=2)[0]
        except OSError:
            return 0

    def drop_to(self, services: Sequence[str], ports: Sequence[int], *, to_drop: bool) -> None:
        """Let containers reach nothing at these TCP ports, or again; what a new container does is not hindered."""
        for service in services:
            container = self.container(service)
            pid = container.attrs["State"]["Pid"]
            if pid:
                drop(["nsenter", "-t", str(pid), "-n"], ports, to_drop=to_drop)


def drop(inside: Sequence[str], ports: Sequence[int], *, to_drop: bool) -> None:
    """Drop all packets to and from TCP ports of others in the network that `inside` runs a command in, or no more."""
    how = "-I" if to_drop else "-D"
    for port in dict.fromkeys(ports):
        for chain, side in (("OUTPUT", "--dport"), ("INPUT", "--sport")):
            rule = [how, chain, "-p", "tcp", side, str(port), "-j", "DROP"]
            # A rule that has gone with its container needs not be taken back.
            (output_of_command if to_drop else run_command)(*inside, "iptables", "-w", *rule)


class Site:
    """All cells, the first of which has the database, and the world in which robots enrol at them."""

    def __init__(self, cells: Sequence[Cell], world: World) -> None:
        self.cells = list(cells)
        # Its stack is the first cell.
        self.world = world

    @classmethod
    @contextmanager
    def started(cls, folder: World, count: int) -> Iterator[Site]:
        with ExitStack() as made:
            first = first_cell(folder.folder / "site")
            first.engine.images.build(path=str(CLOCK), tag=CLOCK_IMAGE, rm=True)
            _add_clock(first)
            made.callback(first.down)
            first.up(robots=False)
            stacks = {"a": first}
            for name in "bcdefgh"[: count - 1]:
                stacks[name] = made.enter_context(second_cell(first, name, prepare=_add_clock))
            world = World(first.container, folder.folder)
            cells = [Cell(name, item, world.machine) for name, item in stacks.items()]
            yield cls(cells, world)

    @property
    def names(self) -> list[str]:
        return [cell.name for cell in self.cells]

    @property
    def addresses(self) -> list[dict[str, str]]:
        return [{"name": cell.name, "address": cell.address} for cell in self.cells]

    def people(self, prefix: str, count: int) -> list[dict[str, str]]:
        names = [f"{prefix}-{number}" for number in range(1, count + 1)]
        return [{"name": name, "token": self.world.admin_token(name)} for name in names]

    def wait_live(self) -> None:
        for cell in self.cells:
            cell.wait_live()

    def sql(self, query: str) -> list[list[str]]:
        return self.cells[0].stack.sql(query)


def offset_bytes(seconds: float) -> bytes:
    return struct.pack("q", round(seconds * NS_PER_S))


def _add_clock(stack: Stack) -> None:
    folder = stack.folder / "clock"
    folder.mkdir(parents=True, exist_ok=True)
    here = {str(folder): {"bind": "/out"}}
    stack.engine.containers.run(CLOCK_IMAGE, remove=True, volumes=here)
    (folder / OFFSET).write_bytes(offset_bytes(0.0))
    for path in (folder, *folder.iterdir()):
        path.chmod(0o755)
    stack.settings["STEPPED_CLOCK"] = folder
    stack.settings["COMPOSE_FILE"] = f"{stack.settings['COMPOSE_FILE']}:{CLOCK / 'compose.yaml'}"


def _signal(container: Container, which: Signals) -> None:
    """Send all processes of a container a signal, and those that begin meanwhile.

    The engine's pause is the kernel's freezer, which gives up where processes fork, and hangs beside a health check.
    """
    inside = _namespace(container.attrs["State"]["Pid"])
    sent: set[int] = set()
    while found := {pid for pid, _ in words_of_all() if _namespace(pid) == inside} - sent:
        for pid in found:
            with suppress(ProcessLookupError):
                os.kill(pid, which)
        sent |= found


def _namespace(pid: int) -> str:
    """Which namespace of processes a process is in; empty when it is gone."""
    try:
        return str(Path(f"/proc/{pid}/ns/pid").readlink())
    except OSError:
        return ""
