"""The guard as a process: puts its parts together, hears the agent, and ends with the robot stopped.

Run by `python -m robotether_agent.guard`. Standard input and output are the agent's pipes; the end of input, `exit`
and SIGTERM are one: zeros, then the end.
"""

from __future__ import annotations

import asyncio
import logging
import signal
import sys
from contextlib import suppress
from pathlib import Path

import aiohttp

from robotether_agent.clock import robot_time
from robotether_agent.fields import FieldError
from robotether_agent.guard.authority import Authority
from robotether_agent.guard.drive_line import DriveLine
from robotether_agent.guard.helm import Helm
from robotether_agent.guard.latch import Latch
from robotether_agent.guard.marks import MotionFile, StopFile
from robotether_agent.guard.orders import (
    Config,
    Exit,
    Lease,
    Order,
    Release,
    SessionIs,
    Stop,
    parse,
)
from robotether_agent.guard.reports import Reports, State
from robotether_agent.guard.server import Server
from robotether_agent.guard.sockets import new_http
from robotether_agent.tasks import first_of, within

TICK_EVERY_S = 0.2
# The zeros take 0.5 s; a rosbridge that does not take them must not keep the guard, which leaves its mark.
LAST_ZEROS_WITHIN_S = 1.0
LAST_WRITE_WITHIN_S = 2.0
LONGEST_LINE = 64 * 1024

log = logging.getLogger(__name__)


class Guard:
    """All parts of a running guard."""

    def __init__(
        self, http: aiohttp.ClientSession, state_dir: Path, run_dir: Path, reports: Reports
    ) -> None:
        self._clock = robot_time
        self._reports = reports
        self._config: Config | None = None
        self._ending = asyncio.Event()
        self._authority = Authority(self._clock())
        self._helm = Helm(self._authority, MotionFile(run_dir), self._clock, self._tell)
        self._helm.line = self._line = DriveLine(http, self._helm, self._clock)
        self._server = Server(
            http, self._authority, self._helm, lambda: self._config, lambda: self._line.up
        )
        self._latch = Latch(StopFile(state_dir), self._latch_changed, self._answer)
        self._authority.stopped = self._latch.stopped

    async def run(self, lines: asyncio.StreamReader) -> None:
        """Guard the robot until the agent ends it, or itself."""
        self._reports.ready(await self._server.start())
        self._tell()
        try:
            await first_of(
                self._until_stood(),
                self._hear(lines),
                self._tick(),
                self._helm.run(),
                self._line.run(),
                self._latch.run(),
            )
        finally:
            await self._server.stop()

    def end(self) -> None:
        """Stop the robot, then end."""
        self._ending.set()

    async def _until_stood(self) -> None:
        await self._ending.wait()
        self._authority.ending = True
        self._helm.halt()
        with suppress(asyncio.TimeoutError):
            await within(LAST_ZEROS_WITHIN_S, self._helm.until_it_stands())
        self._helm.close()
        with suppress(asyncio.TimeoutError):
            await within(LAST_WRITE_WITHIN_S, self._latch.settled())

    async def _hear(self, lines: asyncio.StreamReader) -> None:
        """Do what the agent says; its end is the guard's."""
        while True:
            try:
                line = await lines.readline()
            except ValueError:
                log.error("the agent sent a line over %d bytes", LONGEST_LINE)  # noqa: TRY400 - no defect
                continue
            if not line:
                break
            self._obey(line)
        self.end()
        await asyncio.Event().wait()

    def _obey(self, line: bytes) -> None:
        # Whatever it is, the agent lives.
        self._authority.heard(self._clock())
        try:
            order = parse(line)
        except FieldError as error:
            log.error("cannot do what the agent says: %s", error)  # noqa: TRY400 - no defect
            return
        if order is not None:
            self._do(order)

    def _do(self, order: Order) -> None:
        if isinstance(order, Config):
            self._use(order)
        elif isinstance(order, SessionIs):
            self._authority.session(up=order.up)
            self._server.rights_changed()
        elif isinstance(order, Lease):
            self._authority.lease(order.fence, held=order.held)
            self._server.rights_changed()
        elif isinstance(order, Stop | Release):
            self._latch.order(order)
        elif isinstance(order, Exit):
            self.end()

    def _use(self, config: Config) -> None:
        first, self._config = self._config is None, config
        self._authority.key, self._authority.direct = config.key, config.direct
        self._helm.use(config)
        if first:
            self._helm.resume()
        self._line.use(config.rosbridge_url)
        self._server.rights_changed()

    def _latch_changed(self) -> None:
        if self._latch.stopped:
            log.warning("%s stopped the robot", self._latch.by or "somebody")
            self._authority.stop()
            self._helm.stop()
        else:
            self._authority.release()
        self._server.rights_changed()
        self._tell()

    def _answer(self, order_id: str) -> None:
        self._tell(answers=order_id)

    def _tell(self, *, answers: str | None = None) -> None:
        by = self._latch.told_by
        state = State(by is not None, by or "", self._helm.moving)
        self._reports.state(state, self._helm.refusals, answers=answers)

    async def _tick(self) -> None:
        while True:
            self._reports.tick()
            self._tell()
            await asyncio.sleep(TICK_EVERY_S)


async def run(state_dir: Path, run_dir: Path) -> None:
    """Run a guard on this process's standard input and output."""
    lines, pipe = await _standard_input(), await _standard_output()
    async with new_http() as http:
        guard = Guard(http, state_dir, run_dir, Reports(pipe))
        for number in (signal.SIGTERM, signal.SIGINT):
            asyncio.get_running_loop().add_signal_handler(number, guard.end)
        await guard.run(lines)
    pipe.close()


async def _standard_input() -> asyncio.StreamReader:
    lines = asyncio.StreamReader(limit=LONGEST_LINE)
    protocol = asyncio.StreamReaderProtocol(lines)
    await asyncio.get_running_loop().connect_read_pipe(lambda: protocol, sys.stdin)
    return lines


async def _standard_output() -> asyncio.WriteTransport:
    loop = asyncio.get_running_loop()
    pipe, _ = await loop.connect_write_pipe(asyncio.BaseProtocol, sys.stdout)
    return pipe
