"""What comes back by itself, and when, after a program of the stack was killed or stopped.

One program after the other gets SIGKILL, and then SIGSTOP for a minute, while a person's and a robot's attempts are
repeated: the site's health, a log-in, a drive, and a robot's SSH log-in at each port. Used by `bench`; needs
`make demo` and root. `direct` and `acme` are not among them: the demo has neither.
"""

from __future__ import annotations

import asyncio
import math
import os
import signal
import sys
import time
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from http.client import HTTPException

import processes
from demo import Demo
from logins import Login
from paper.client import FAILURES, Client, new_http
from programs import open_echo
from report import NONE, Row, Section

DRIVEN, LOGS_IN = "sim1", "sim2"
STOPPED_S = 60.0
# Time limit for a program to come back.
GIVE_UP_S = 180.0
# Time for which every attempt must succeed, so that what fails late is seen; longer than one attempt.
CALM_S = 12.0
ATTEMPT_S = 10.0
PAUSE_S = 1.0
BROKEN_ANSWERS = (AssertionError, HTTPException, KeyError, TypeError, ValueError)
# As the agent logs in, but for its session, which the relay would put in place of the agent's own.
SSH_LOG_IN = (
    "cd /var/lib/robotether-agent && rm -f /tmp/{port}.ctl && "
    "ssh -F none -N -f -M -S /tmp/{port}.ctl -i id_ed25519 -o BatchMode=yes -o HostKeyAlias=robotether-server "
    "-o IdentitiesOnly=yes -o UserKnownHostsFile=known_hosts -o ConnectTimeout=9 -p {port} tunnel@cloud && "
    "ssh -F none -S /tmp/{port}.ctl -O exit x"
)


@dataclass(frozen=True)
class Program:
    """A program of a service, and how its processes look in `ps -o comm,args`."""

    name: str
    service: str
    looks: str

    def pids(self, demo: Demo) -> list[int]:
        """Its processes as this machine numbers them, the main one first; none while the container is away."""
        container = demo.container(self.service)
        if container.status != "running":
            return []
        return processes.matching(container, self.looks)


PROGRAMS = (
    Program("mysql", "mysql", "^mariadbd "),
    Program("web", "web", "^python3 .*gunicorn"),
    Program("relay", "relay", r"^python3 .*robotether_server\.relay"),
    Program("nginx", "nginx", "^nginx "),
    Program("sshd", "sshd", r"^sshd .*\[listener\]"),
    Program("sshd's nginx", "sshd", "^nginx "),
    Program("sshd's key-lookups", "sshd", "^key-lookups "),
    Program("sshd's jump-watch", "sshd", "^jump-watch "),
    Program("sshd's tunnel-watch", "sshd", "^tunnel-watch "),
    Program("the robot's agent", DRIVEN, "^python3 .*robotether_agent run"),
    Program("the robot's guard", DRIVEN, "^robot-guard "),
    Program("the robot's maker of guards", DRIVEN, "^guard-forks "),
    Program("the robot's rosbridge", DRIVEN, "^python3 .*sim_robot$"),
)


@dataclass
class Sign:
    """Something that is tried again and again: when an attempt began and ended, and whether it succeeded."""

    name: str
    attempt: Callable[[], Awaitable[bool]]
    tries: list[tuple[float, float, bool]] = field(default_factory=list)

    async def watch(self) -> None:
        while True:
            began = time.monotonic()
            succeeded = False
            # An attempt fails in whatever way the stack does.
            with suppress(*FAILURES, *BROKEN_ANSWERS):
                succeeded = await asyncio.wait_for(self.attempt(), ATTEMPT_S)
            self.tries.append((began, time.monotonic(), succeeded))
            await asyncio.sleep(PAUSE_S)

    def is_calm(self, since: float) -> bool:
        """Whether every attempt since then succeeded, and there was one."""
        recent = [succeeded for began, _, succeeded in self.tries if began > since]
        return bool(recent) and all(recent)

    def outage(self, since: float) -> str:
        """From when to when attempts failed, in seconds after `since`."""
        failed = [
            began for began, ended, succeeded in self.tries if not succeeded and ended > since
        ]
        if not failed:
            return NONE
        back = [ended for began, ended, succeeded in self.tries if succeeded and began > failed[-1]]
        first = max(0.0, failed[0] - since)
        return f"{first:.0f} to {back[0] - since:.0f}" if back else f"from {first:.0f} on"


class Attempts:
    """What a person, a program and a robot try."""

    def __init__(self, demo: Demo) -> None:
        # Asked for while all is well: they start programs.
        self._address, self._url = demo.address, demo.url
        self._password, self._token = demo.admin_password, demo.token
        self._robot_pid = demo.container(LOGS_IN).attrs["State"]["Pid"]
        self._ssh_ports = [
            demo.compose("port", *published).strip().rsplit(":", 1)[1]
            for published in (("sshd", "2222"), ("nginx", "8443"))
        ]

    def signs(self) -> list[Sign]:
        """All of them, in the table's order."""
        return [
            Sign("`/healthz` not ok", self._is_healthy),
            Sign("no log-in", self._logs_in),
            Sign("robot not drivable", self._drives),
            Sign("no SSH log-in", lambda: self._ssh_logs_in(self._ssh_ports[0])),
            Sign("no SSH log-in at 443", lambda: self._ssh_logs_in(self._ssh_ports[1])),
        ]

    async def _is_healthy(self) -> bool:
        async with new_http() as http, http.get(f"{self._url}/healthz") as answer:
            return answer.status == 200

    async def _logs_in(self) -> bool:
        login = await asyncio.to_thread(Login, self._url, "admin", self._password)
        return login.is_in

    async def _drives(self) -> bool:
        """A new drive connection passes a message to the robot and back."""
        async with new_http() as http:
            client = Client(http, self._address, self._token, ATTEMPT_S)
            async with await client.connect(DRIVEN) as socket:
                await open_echo(socket, "/comebacks")
                return True

    async def _ssh_logs_in(self, port: str) -> bool:
        """Log in with a robot's key, beside its agent; without the engine, which is slow on a busy machine."""
        command = ("timeout", f"{ATTEMPT_S - 1:g}", "sh", "-c", SSH_LOG_IN.format(port=port))
        process = await asyncio.create_subprocess_exec(
            "nsenter", f"--target={self._robot_pid}", "--all", *command,
            stdout=asyncio.subprocess.DEVNULL, stderr=asyncio.subprocess.DEVNULL,
        )  # fmt: skip
        return await process.wait() == 0


@dataclass
class Fault:
    """One program that was hurt, at `at`, and when it ran again in other processes."""

    program: Program
    signal: signal.Signals
    at: float = math.nan
    replaced_s: float | None = None

    @property
    def row(self) -> Row:
        """The program, what happened to it, and when it ran again."""
        killed = self.signal == signal.SIGKILL
        never = f"not in {GIVE_UP_S:g}" if killed else NONE
        again = never if self.replaced_s is None else f"{self.replaced_s:.0f}"
        fault = "killed" if killed else "stopped"
        return {"program": self.program.name, "fault": fault, "new process": again}

    def hurt(self, demo: Demo) -> list[int]:
        """Send the signal: SIGKILL to the main process, SIGSTOP to all of the program."""
        pids = self.program.pids(demo)
        if not pids:
            raise RuntimeError(f"cannot measure: {self.program.name} does not run")
        hurt = pids[:1] if self.signal == signal.SIGKILL else pids
        self.at = time.monotonic()
        for pid in hurt:
            os.kill(pid, self.signal)
        return hurt

    def look(self, demo: Demo, hurt: Sequence[int]) -> None:
        """Note when none of the hurt processes is there and others are."""
        pids = self.program.pids(demo)
        if self.replaced_s is None and pids and not set(pids) & set(hurt):
            self.replaced_s = time.monotonic() - self.at


async def _endure(demo: Demo, fault: Fault, signs: Sequence[Sign]) -> None:
    """Bring the fault about and wait until all signs are good again, or for GIVE_UP_S."""
    hurt = await asyncio.to_thread(fault.hurt, demo)
    while (passed := time.monotonic() - fault.at) < GIVE_UP_S:
        await asyncio.sleep(PAUSE_S)
        await asyncio.to_thread(fault.look, demo, hurt)
        goes_on = fault.signal == signal.SIGSTOP and passed > STOPPED_S
        if goes_on:
            _send_all(hurt, signal.SIGCONT)
        if (goes_on or fault.replaced_s is not None) and passed > CALM_S and _are_calm(signs):
            return
    _send_all(hurt, signal.SIGCONT)
    await asyncio.to_thread(demo.container(fault.program.service).restart)


def _send_all(pids: Sequence[int], number: signal.Signals) -> None:
    for pid in pids:
        with suppress(ProcessLookupError):
            os.kill(pid, number)


def _are_calm(signs: Sequence[Sign]) -> bool:
    return all(sign.is_calm(time.monotonic() - CALM_S) for sign in signs)


async def _until_calm(signs: Sequence[Sign]) -> None:
    end = time.monotonic() + GIVE_UP_S
    await asyncio.sleep(CALM_S)
    while not _are_calm(signs):
        if time.monotonic() > end:
            bad = [sign.name for sign in signs if not sign.is_calm(time.monotonic() - CALM_S)]
            raise RuntimeError(f"cannot go on: after {GIVE_UP_S:g} s still {', '.join(bad)}")
        await asyncio.sleep(PAUSE_S)


async def _measure_all(demo: Demo, faults: Sequence[Fault]) -> list[Row]:
    rows = []
    async with asyncio.TaskGroup() as group:
        signs = Attempts(demo).signs()
        watches = [group.create_task(sign.watch()) for sign in signs]
        for fault in faults:
            await _until_calm(signs)
            await _endure(demo, fault, signs)
            rows.append({**fault.row, **{sign.name: sign.outage(fault.at) for sign in signs}})
            sys.stderr.write(f"{' | '.join(rows[-1].values())}\n")
        for watch in watches:
            watch.cancel()
    return rows


def measure(demo: Demo, programs: Sequence[Program] = PROGRAMS) -> Section:
    faults = [
        Fault(program, number)
        for program in programs
        for number in (signal.SIGKILL, signal.SIGSTOP)
    ]
    rows = asyncio.run(_measure_all(demo, faults))
    return Section(
        title="What comes back by itself after it was killed or hung",
        text=f"SIGKILL of the main process, or SIGSTOP of all of it for {STOPPED_S:g} s, once each. The columns "
        "of numbers are seconds after the signal: the program ran again in a new process, and from when to when an "
        f"attempt failed; {NONE} is never. An attempt fails that takes longer than {ATTEMPT_S:g} s; there is one each "
        f"{PAUSE_S:g} s. A program without a new process went on when the {STOPPED_S:g} s were over. A container keeps "
        "the simulated robot; on a real one, systemd ends an agent that hangs after 20 s.\n\nAim: everything is back "
        "within 60 s without a person.",
        rows=rows,
    )
