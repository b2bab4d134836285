"""The guard's process: builds its parts, reads the agent's lines, and ends with the robot stopped.

Forked by the fork server, or run by `python -m robotether_agent.guard`. Standard input and output are the agent's
pipes; the end of input, `exit` and SIGTERM are one: zeros, then the end.
"""

from __future__ import annotations

import asyncio
import logging
import os
import signal
from contextlib import suppress
from pathlib import Path

import aiohttp

from robotether_agent.clock import robot_time
from robotether_agent.fields import FieldError
from robotether_agent.guard.agent_messages import (
    AgentMessage,
    Exit,
    FrameSent,
    GuardConfig,
    GuardReporter,
    LeaseUpdate,
    ReleaseRequest,
    SessionIs,
    State,
    StopRequest,
    parse,
)
from robotether_agent.guard.authorizer import Authorizer
from robotether_agent.guard.drive_controller import DriveController
from robotether_agent.guard.fences import FenceFile, FenceStore
from robotether_agent.guard.latch import Latch, StopFile
from robotether_agent.guard.rosbridge import CmdVelPublisher, SubscriberWatch
from robotether_agent.guard.server import Server
from robotether_agent.guard.topics import MotionFile
from robotether_agent.rosbridge_socket import new_http
from robotether_agent.tasks import first_of, within

TICK_EVERY_S = 0.2
# Time limit for the last zeros, which take 0.5 s: a rosbridge that does not read must not delay the
# guard's end. The motion file stays.
LAST_ZEROS_WITHIN_S = 1.0
LAST_WRITE_WITHIN_S = 2.0
MAX_LINE_BYTES = 64 * 1024

log = logging.getLogger(__name__)


class Guard:
    """All parts of a running guard."""

    def __init__(
        self, http: aiohttp.ClientSession, state_dir: Path, run_dir: Path, reporter: GuardReporter
    ) -> None:
        self._clock = robot_time
        self._reporter = reporter
        self._config: GuardConfig | None = None
        self._exiting = asyncio.Event()
        self._fences = FenceStore(FenceFile(state_dir))
        self._authorizer = Authorizer(self._clock(), self._fences.on_disk)
        self._publisher = CmdVelPublisher(http, self._clock)
        self._controller = DriveController(
            self._publisher,
            self._authorizer,
            MotionFile(run_dir),
            self._clock,
            self._report_state,
        )
        self._watch = SubscriberWatch(
            self._controller, lambda: self._config.rosbridge_url if self._config else ""
        )
        self._server = Server(
            http,
            self._authorizer,
            self._controller,
            lambda: self._config,
            lambda: self._publisher.up,
            keep_fence=self._fences.keep,
        )
        self._latch = Latch(StopFile(state_dir), self._latch_changed, self._answer)
        self._authorizer.stopped = self._latch.stopped

    async def run(self, lines: asyncio.StreamReader) -> None:
        """Guard the robot until the agent ends it, or itself."""
        self._reporter.ready(await self._server.start())
        self._report_state()
        try:
            await first_of(
                self._until_at_rest(),
                self._receive(lines),
                self._tick(),
                self._controller.run(),
                self._publisher.run(self._controller),
                self._watch.run(),
                self._latch.run(),
            )
        finally:
            await self._server.stop()
            with suppress(asyncio.TimeoutError):
                await within(LAST_WRITE_WITHIN_S, self._fences.settled())

    def end(self) -> None:
        """Stop the robot, then end."""
        self._exiting.set()

    async def _until_at_rest(self) -> None:
        await self._exiting.wait()
        self._authorizer.exiting = True
        self._controller.halt()
        with suppress(asyncio.TimeoutError):
            await within(LAST_ZEROS_WITHIN_S, self._controller.until_at_rest())
        self._controller.close()
        with suppress(asyncio.TimeoutError):
            await within(LAST_WRITE_WITHIN_S, self._latch.settled())

    async def _receive(self, lines: asyncio.StreamReader) -> None:
        """Do what the agent says; its end is the guard's."""
        while True:
            try:
                line = await lines.readline()
            except ValueError:
                log.error("the agent sent a line over %d bytes", MAX_LINE_BYTES)  # noqa: TRY400 - no defect
                continue
            if not line:
                break
            self._on_line(line)
        self.end()
        await asyncio.Event().wait()

    def _on_line(self, line: bytes) -> None:
        # Whatever it is, the agent is alive.
        self._authorizer.on_agent_message(self._clock())
        try:
            message = parse(line)
        except FieldError as error:
            log.error("cannot handle a line of the agent: %s", error)  # noqa: TRY400 - no defect
            return
        if message is not None:
            self._handle(message)

    def _handle(self, message: AgentMessage) -> None:
        if isinstance(message, GuardConfig):
            self._apply_config(message)
        elif isinstance(message, SessionIs):
            self._authorizer.session(up=message.up)
            self._server.rights_changed()
        elif isinstance(message, LeaseUpdate):
            self._authorizer.lease(message.fence, held=message.held)
            # Begun now, so that the driver, who comes right behind, need not wait for it.
            self._fences.note(message.fence)
            self._server.rights_changed()
        elif isinstance(message, StopRequest | ReleaseRequest):
            self._latch.handle(message)
        elif isinstance(message, FrameSent):
            taken_s = message.taken_ms / 1000
            frames = self._controller.frame_times
            frames.note(message.camera, message.frame, taken_s, self._clock())
        elif isinstance(message, Exit):
            self.end()

    def _apply_config(self, config: GuardConfig) -> None:
        first, self._config = self._config is None, config
        self._authorizer.key, self._authorizer.direct = config.key, config.direct
        self._controller.use(config)
        if first:
            self._controller.resume()
        self._publisher.use(config.rosbridge_url)
        self._server.rights_changed()

    def _latch_changed(self) -> None:
        if self._latch.stopped:
            log.warning("%s stopped the robot", self._latch.by or "somebody")
            self._authorizer.stop()
            self._controller.stop()
        else:
            self._authorizer.release()
        self._server.rights_changed()
        self._report_state()

    def _answer(self, message_id: str) -> None:
        self._report_state(answers=message_id)

    def _report_state(self, *, answers: str | None = None) -> None:
        by = self._latch.reported_by
        names = self._controller.unheard
        unheard = None if names is None else tuple(sorted(names))
        fence = self._authorizer.fence
        state = State(by is not None, by or "", self._controller.moving, fence, unheard)
        controller = self._controller
        self._reporter.state(state, controller.refusals, controller.stops, answers=answers)
        self._reporter.seen(self._controller.seen_ages)

    async def _tick(self) -> None:
        while True:
            self._reporter.tick()
            self._report_state()
            await asyncio.sleep(TICK_EVERY_S)


def main(state_dir: Path, run_dir: Path) -> int:
    """Run a guard on this process's standard input and output until it ends; return the exit code."""
    asyncio.run(_run(state_dir, run_dir))
    return 0


async def _run(state_dir: Path, run_dir: Path) -> None:
    lines, pipe = await _standard_input(), await _standard_output()
    async with new_http() as http:
        guard = Guard(http, state_dir, run_dir, GuardReporter(pipe))
        for number in (signal.SIGTERM, signal.SIGINT):
            asyncio.get_running_loop().add_signal_handler(number, guard.end)
        await guard.run(lines)
    pipe.close()


async def _standard_input() -> asyncio.StreamReader:
    lines = asyncio.StreamReader(limit=MAX_LINE_BYTES)
    protocol = asyncio.StreamReaderProtocol(lines)
    await asyncio.get_running_loop().connect_read_pipe(lambda: protocol, os.fdopen(0, "rb", 0))
    return lines


async def _standard_output() -> asyncio.WriteTransport:
    loop = asyncio.get_running_loop()
    pipe, _ = await loop.connect_write_pipe(asyncio.BaseProtocol, os.fdopen(1, "wb", 0))
    return pipe
