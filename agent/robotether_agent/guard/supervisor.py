"""Keeps the guard running while the agent runs, and connects it to the robot's session.

Run by the agent. What the server wants goes to the guard at once, and again to each new one after a crash; what the
guard says goes to the session unchanged. Never stops trying to have a guard, never hands on a release that a dead
guard left undone, and never lets a connection past it: while there is none, nothing leads to rosbridge.
"""

from __future__ import annotations

import asyncio
import logging
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import NoReturn

from robotether_common.guard import REFUSED_KINDS

from robotether_agent.fields import (
    JsonObject,
    get_flag,
    get_int,
    get_match,
    get_text,
    line_of,
    printable,
)
from robotether_agent.guard import agent_messages
from robotether_agent.guard.child_process import GuardProcess
from robotether_agent.guard.fork_server import ForkServer
from robotether_agent.problems import GuardDownError
from robotether_agent.tasks import first_of

# Time after which a guard counts as stable: its end is then a new problem.
STABLE_S = 3.0
FIRST_PAUSE_S = 0.1
# Maximum pause before a guard is replaced; the next one must stop a moving robot within a second.
MAX_PAUSE_S = 0.4
FORK_SERVER_CHECK_S = 1.0
# Maximum number of lines that a session has not sent yet.
MAX_UNSENT_LINES = 64
# Maximum length of the names of drive topics in the status.
MAX_NAMES_LENGTH = 500
# Message that gives a new guard the stop that the previous one had confirmed.
LATCH_ID = "kept"
STATE = re.compile("ready|down")
NO_STATUS = MappingProxyType({"moving": False, "refused": dict.fromkeys(REFUSED_KINDS, 0)})

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class GuardView:
    """How the guard is: `port` None is no guard; `stopped` is the latch, `by` who set it."""

    state: str = "down"
    port: int | None = None
    stopped: bool = False
    by: str = ""
    detail: str = "it starts"


def pause_before(restart: int) -> float:
    """Return the seconds before the restart number `restart` in a row: the first one comes at once."""
    return 0.0 if restart <= 1 else min(MAX_PAUSE_S, FIRST_PAUSE_S * 2 ** min(restart - 2, 10))


class GuardSupervisor:
    """The guard of one robot, whichever process it is now."""

    def __init__(
        self,
        rosbridge_url: str,
        command: Sequence[str],
        *,
        fork_server: ForkServer | None = None,
        on_change: Callable[[GuardView], None] = lambda _: None,
    ) -> None:
        self.view = GuardView()
        self._rosbridge_url = rosbridge_url
        self._command = command
        self._on_change = on_change
        self._guard: GuardProcess | None = None
        self._fork_server = fork_server
        self._followers: set[asyncio.Queue[JsonObject]] = set()
        self._last_status: JsonObject | None = None
        # What a new guard is sent.
        self._config_line = self._config({}, direct=False)
        self._session_up = False
        self._lease: JsonObject | None = None
        self._unanswered_stop: JsonObject | None = None

    async def run(self) -> NoReturn:
        """Have a guard, one after the other; when cancelled, return once it has stopped the robot."""
        restarts = 0
        try:
            while True:
                began = time.monotonic()
                try:
                    await self._run_one()
                except GuardDownError as problem:
                    restarts = 1 if time.monotonic() - began >= STABLE_S else restarts + 1
                    pause_s = pause_before(restarts)
                    log.warning("%s; another one follows in %.1f s", problem, pause_s)
                    self._is_down(problem.message)
                    await asyncio.sleep(pause_s)
        finally:
            if self._fork_server is not None:
                self._fork_server.close()

    @contextmanager
    def following(self) -> Iterator[asyncio.Queue[JsonObject]]:
        """Give one session what the guard says: first how it is now, then each of its lines."""
        queue: asyncio.Queue[JsonObject] = asyncio.Queue(MAX_UNSENT_LINES)
        if self._last_status is not None:
            # Before the first guard has looked nobody knows whether this robot is stopped.
            queue.put_nowait(self._state_now(self._last_status))
        self._followers.add(queue)
        try:
            yield queue
        finally:
            self._followers.discard(queue)

    def on_config(self, guard: JsonObject, *, direct: bool) -> None:
        """Follow the session's configuration; what the guard would not take raises FieldError and changes nothing."""
        # Without a key in it the guard refuses every connection of a relay.
        config = self._config(guard, direct=direct)
        agent_messages.parse(line_of(config))
        self._config_line = config
        self._session_up = True
        self._send(self._config_line)
        self._send({"type": "session", "up": True})

    def on_session_lost(self) -> None:
        """Let the guard stop the robot: its session has ended."""
        self._session_up = False
        if self._lease is not None:
            self._lease = {**self._lease, "held": False}
        self._send({"type": "session", "up": False})

    def on_lease(self, fence: int, *, held: bool) -> None:
        """Send the newest fencing number, and whether anybody holds it."""
        self._lease = {"type": "lease", "fence": fence, "held": held}
        self._send(self._lease)

    def is_driven(self) -> bool:
        """Return whether somebody holds the lease, as the server last said."""
        return self._lease is not None and bool(self._lease["held"])

    def on_stop(self, message_id: str, by: str) -> None:
        """Stop the robot, now or as soon as there is a guard."""
        log.warning("%s stopped this robot; a driver must release it", by)
        self._unanswered_stop = {"type": "stop", "id": message_id, "by": by}
        self._send(self._unanswered_stop)

    def on_release(self, message_id: str, by: str) -> None:
        """Release the robot, now or never: what comes late could release a later stop."""
        log.warning("%s releases this robot", by)
        if self._unanswered_stop is not None:
            log.warning("not released: the guard has not confirmed the stop yet")
            return
        self._send({"type": "release", "id": message_id, "by": by})

    def on_frame_sent(self, camera: str, frame: int, taken_s: float) -> None:
        """Report a frame that leaves the robot; a guard that misses it does not know how old it is."""
        if self._guard is not None:
            taken_ms = round(taken_s * 1000, 3)
            self._guard.offer(
                {"type": "frame", "camera": camera, "frame": frame, "taken_ms": taken_ms}
            )

    async def _run_one(self) -> NoReturn:
        try:
            guard = await self._start_guard()
        except OSError as error:
            # The fork server is not to blame, and stays.
            raise GuardDownError(f"cannot start the guard: {error.strerror}") from error
        log.debug("guard %d takes over", guard.pid)
        try:
            self._guard = guard
            self._keep_stop()
            for message in self._replay():
                guard.send(message)
            await self._serve(guard)
        except GuardDownError:
            # Also of one that only hangs: two guards at once must never drive.
            await guard.kill()
            raise
        finally:
            self._guard = None
            await guard.end()

    async def _serve(self, guard: GuardProcess) -> NoReturn:
        await first_of(guard.serve(self._on_line), self._keep_fork_server())
        raise GuardDownError("the guard ended")

    async def _start_guard(self) -> GuardProcess:
        if self._fork_server is not None:
            try:
                return await GuardProcess.start(self._fork_server)
            except GuardDownError as problem:
                self._drop_fork_server(problem)
        self._fork_server = ForkServer.start(self._command)
        return await GuardProcess.start(self._fork_server)

    async def _keep_fork_server(self) -> NoReturn:
        """Have a fork server that answers, so that the next guard need not wait for Python to start."""
        while True:
            await asyncio.sleep(FORK_SERVER_CHECK_S)
            try:
                self._fork_server = self._fork_server or ForkServer.start(self._command)
                await self._fork_server.check()
            except GuardDownError as problem:
                self._drop_fork_server(problem)

    def _drop_fork_server(self, problem: GuardDownError) -> None:
        log.warning("%s; another one follows", problem)
        if self._fork_server is not None:
            self._fork_server.kill()
        self._fork_server = None

    def _keep_stop(self) -> None:
        """Send the stop of the last guard to this one, which may not have found it: disks fail."""
        if self.view.stopped and self._unanswered_stop is None:
            self._unanswered_stop = {"type": "stop", "id": LATCH_ID, "by": self.view.by}

    def _replay(self) -> Iterator[JsonObject]:
        yield self._config_line
        yield {"type": "session", "up": self._session_up}
        if self._lease is not None:
            yield self._lease
        if self._unanswered_stop is not None:
            yield self._unanswered_stop

    def _config(self, guard: JsonObject, *, direct: bool) -> JsonObject:
        where = {"type": "config", "rosbridge_url": self._rosbridge_url}
        return {**where, "guard": guard, "direct": direct}

    def _send(self, message: Mapping[str, object]) -> None:
        if self._guard is not None:
            self._guard.send(message)

    def _on_line(self, message: JsonObject) -> None:
        kind = get_text(message, "type")
        if kind == "ready":
            self._is_ready(get_int(message, "port", 1, 65535))
        elif kind == "guard":
            self._on_status(message)
        elif kind == "seen":
            self._notify(message)

    def _is_ready(self, port: int) -> None:
        log.info("the guard before %s is ready", self._rosbridge_url)
        self._set(replace(self.view, state="ready", port=port, detail=""))

    def _on_status(self, message: JsonObject) -> None:
        state = get_match(message, "state", STATE, "ready or down")
        stopped = get_flag(message, "stopped", default=True)
        by = get_text(message, "by", default="", limit=200)
        stop = self._unanswered_stop
        if stop is not None and message.get("answers") == stop["id"]:
            self._unanswered_stop = None
        self._last_status = message
        detail = _unheard(message) if state == "ready" else self.view.detail
        self._set(replace(self.view, state=state, stopped=stopped, by=by, detail=detail))
        self._notify(message)

    def _is_down(self, detail: str) -> None:
        self._set(replace(self.view, state="down", port=None, detail=detail))
        self._last_status = self._last_status or NO_STATUS
        self._notify(self._state_now(self._last_status))

    def _state_now(self, status: JsonObject) -> JsonObject:
        state = {"state": self.view.state, "stopped": self.view.stopped, "by": self.view.by}
        return {**status, "type": "guard", **state, "answers": None}

    def _notify(self, message: JsonObject) -> None:
        for queue in self._followers:
            if queue.full():
                # The newest line says how it is now.
                queue.get_nowait()
            queue.put_nowait(message)

    def _set(self, view: GuardView) -> None:
        changed = view != self.view
        self.view = view
        if changed:
            self._on_change(view)


def _unheard(message: JsonObject) -> str:
    """Say which drive topics are unheard, or that this is unknown; empty: none is known."""
    topics = message.get("unheard", [])
    if topics is None:
        return agent_messages.LISTENERS_UNKNOWN
    names = ", ".join(str(name) for name in topics) if isinstance(topics, list) else ""
    return f"{agent_messages.UNHEARD} {printable(names, MAX_NAMES_LENGTH)}" if names else ""
