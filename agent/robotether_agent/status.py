"""What the agent is doing, as a JSON file in the run directory, and as text for a person.

Written by the agent, read by `robotether-agent status`. The file is replaced whole, every 2 s and at each
change, so that its age shows whether the agent is alive. Holds no secret: everybody may read it.
"""

from __future__ import annotations

import json
import logging
import os
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, replace
from datetime import datetime, timezone
from pathlib import Path

from robotether_agent import __version__
from robotether_agent.clock import robot_time
from robotether_agent.exposure import PAST_GUARD
from robotether_agent.fields import FieldError, JsonObject, get_number, get_text, parse_object
from robotether_agent.files import read_text, write_atomic
from robotether_agent.problems import AgentError, StateUnusableError

log = logging.getLogger(__name__)

FILE = "status.json"
# Age at which the status is stale: after three missed refreshes the agent has ended or hangs.
STALE_S = 8.0
CONNECTED = "connected"
# Minimum step of the clock by which it was set, as by the network's time on a robot whose clock stops with its power.
CLOCK_STEP_S = 1.0
TIMES = ("since", "problem_at", "problem_over_at")

MEANINGS = {
    "starting": "starting",
    "connecting": "connecting",
    CONNECTED: "connected",
    "pending": "waits for approval on the server",
    "waiting": "not connected, tries again by itself",
    "stopped": "stopped",
}


@dataclass(frozen=True)
class Status:
    """The agent at one time; times are seconds since 1970, `rtt_ms` -1 is unknown."""

    state: str = "starting"
    since: float = 0.0
    server: str = ""
    robot: str = ""
    mac: str = ""
    # The interface that has this MAC now, if any.
    interface: str = ""
    fingerprint: str = ""
    # The address that has the robot's session, or had it last: with several machines, which of them.
    ssh: str = ""
    rtt_ms: float = -1.0
    ros: str = "unknown"
    ros_detail: str = ""
    # The address at which everybody in the robot's own network reaches rosbridge, past the guard.
    ros_exposed: str = ""
    ros_exposed_advice: str = ""
    video: str = "unknown"
    video_detail: str = ""
    # What encodes the cameras that are watched, or why nothing does; empty while none needs an encoder.
    encoder: str = ""
    # ready, down, or off by the settings; and why it is down.
    guard: str = "unknown"
    guard_detail: str = ""
    # Who stopped the robot; empty while it is not stopped.
    stopped_by: str = ""
    # unwatched: it opens for the next viewer; else open or closed.
    video_tunnel: str = "closed"
    # off: nobody wants one; else open or closed.
    shell_tunnel: str = "off"
    # How the robot answers the server at its own end of the tunnels: ok, down or unknown.
    end_to_end_ros: str = "unknown"
    end_to_end_video: str = "unknown"
    end_to_end_shell: str = "unknown"
    # Why the robot has no new key yet, while the server wants one.
    new_key: str = ""
    problem_code: str = ""
    problem: str = ""
    advice: str = ""
    problem_at: float = 0.0
    # 0: the problem is not over, or there was none.
    problem_over_at: float = 0.0
    written_at: float = 0.0
    pid: float = 0
    agent_version: str = __version__


class StatusWriter:
    """Keeps the file in step with the agent."""

    def __init__(
        self,
        run_dir: Path,
        server: str,
        *,
        on_state: Callable[[str], None],
        clock: Callable[[], float] = time.time,
        uptime: Callable[[], float] = robot_time,
    ) -> None:
        self.status = Status(server=server, since=clock(), pid=os.getpid())
        self._file = run_dir / FILE
        self._on_state = on_state
        self._clock = clock
        self._uptime = uptime
        # When the robot started, by the clock.
        self._start = clock() - uptime()
        self._unwritable = False

    def set(self, **changes: str | float) -> None:
        """Change fields, and write the file."""
        now, before = self._now(), self.status
        self.status = replace(before, **changes)  # type: ignore[arg-type]  # fields of two types
        if self.status.state != before.state:
            self.status = replace(self.status, since=now)
        if has_problem(self.status) and _is_whole(self.status):
            self.status = replace(self.status, problem_over_at=now)
        if headline(self.status) != headline(before):
            self._on_state(headline(self.status))
        self.refresh()

    def report_problem(self, problem: AgentError, state: str, **changes: str | float) -> None:
        """Note the last problem, the state that it leads to, and what else it changes."""
        self.set(
            state=state,
            problem_code=problem.code,
            problem=problem.message,
            advice=problem.advice,
            problem_at=self._now(),
            problem_over_at=0.0,
            **changes,
        )

    def refresh(self) -> None:
        """Write the file, which also says that the agent is alive."""
        now = self._now()
        self.status = replace(self.status, written_at=now)
        try:
            write_atomic(self._file, json.dumps(asdict(self.status)) + "\n", 0o644, lasts=False)
        except StateUnusableError as problem:
            # A full disk must not cut the tunnels.
            log.log(logging.DEBUG if self._unwritable else logging.WARNING, "%s", problem)
            self._unwritable = True
        else:
            self._unwritable = False

    def _now(self) -> float:
        """Return the time; what was noted before the clock was set becomes what it would have said then."""
        now = self._clock()
        step_s = now - self._uptime() - self._start
        if abs(step_s) >= CLOCK_STEP_S:
            self._start += step_s
            noted = {name: getattr(self.status, name) for name in TIMES}
            moved = {name: at + step_s for name, at in noted.items() if at}
            self.status = replace(self.status, **moved)
        return now


def headline(status: Status) -> str:
    """Return the status in one line, as systemd shows it."""
    text = MEANINGS.get(status.state, status.state)
    if status.state == CONNECTED:
        services = f"rosbridge {status.ros}, video {status.video}"
        stopped = f"STOPPED by {status.stopped_by}; " if status.stopped_by else ""
        return f"{text} to {status.server} as {status.robot}; {stopped}{services}"
    return f"{text}: {_sentence(status)}" if has_problem(status) else text


def has_problem(status: Status) -> bool:
    """Return whether the last problem, if there was any, still lasts."""
    return bool(status.problem) and not status.problem_over_at


def ended_by_problem(status: Status) -> bool:
    """Return whether the agent ended for its last problem, and not because it was asked to."""
    return status.state == "stopped" and abs(status.since - status.problem_at) < 1


def read_status(run_dir: Path) -> Status | None:
    """Return what the agent wrote last, or None when it never ran since the boot."""
    text = read_text(run_dir / FILE)
    if text is None:
        return None
    try:
        return _parse(parse_object(text, FILE))
    except FieldError:
        return None


def is_alive(status: Status, now: float) -> bool:
    """Return whether the agent that wrote `status` still runs."""
    return status.state != "stopped" and abs(now - status.written_at) < STALE_S


def render(status: Status, now: float, no_encoder: str = "") -> str:
    """Return `status` for a person; `no_encoder` says why video is always JPEG."""
    state, runs = MEANINGS.get(status.state, status.state), is_alive(status, now)
    if not runs and status.state != "stopped":
        # It does not run, hangs, or cannot write the status.
        state = f"no sign of life since {_when(status.written_at)}; see systemctl status robotether-agent"
    else:
        state = f"{state} since {_when(status.since)}"
    rows = [
        ("state", state),
        ("robot", status.robot or "(no name yet)"),
        ("server", status.server),
        ("mac", _mac(status)),
        ("key", status.fingerprint or "(none yet)"),
    ]
    if status.state == CONNECTED and runs:
        rtt = "unknown" if status.rtt_ms < 0 else f"{status.rtt_ms:.1f} ms"
        rows += [
            ("ssh", status.ssh),
            ("round trip", rtt),
            ("video tunnel", video_tunnel(status)),
            ("shell tunnel", status.shell_tunnel),
            ("end to end", _end_to_end(status)),
        ]
    if status.stopped_by:
        rows += [("STOPPED", f"by {status.stopped_by}; a driver releases it on its page")]
    # Without an agent nobody knows them, and there is no guard.
    if runs:
        rows += _service_rows(status, no_encoder)
    if status.new_key:
        rows += [("new key", status.new_key)]
    rows += _problem_rows(status)
    return "\n".join(f"{name:<13} {value}".rstrip() for name, value in rows)


def _service_rows(status: Status, no_encoder: str) -> list[tuple[str, str]]:
    rows = [
        ("guard", _service(status.guard, status.guard_detail)),
        ("rosbridge", _service(status.ros, status.ros_detail)),
        ("video", _service(status.video, status.video_detail)),
    ]
    encoder = f"none: {no_encoder}" if no_encoder else status.encoder
    if encoder:
        rows += [("encoder", encoder)]
    if status.ros_exposed:
        advice = status.ros_exposed_advice
        exposed = f"rosbridge answers at {status.ros_exposed}: {PAST_GUARD}; {advice}"
        rows += [("warning", exposed)]
    return rows


def _problem_rows(status: Status) -> list[tuple[str, str]]:
    if not status.problem:
        return []
    at = _when(status.problem_at)
    if not has_problem(status):
        # Advice on what has mended itself would only make a person mend what works.
        over = f"none now; the last one was over at {_when(status.problem_over_at)}"
        return [("problem", over), ("", f"it came at {at}: {_sentence(status)}")]
    rows = [("problem", _sentence(status)), ("", f"at {at}")]
    return [*rows, ("what to do", status.advice)] if status.advice else rows


def _sentence(status: Status) -> str:
    return f"{status.problem} [{status.problem_code}]"


def _is_whole(status: Status) -> bool:
    """Return whether all that the agent keeps open is open."""
    tunnels = status.video_tunnel != "closed" and status.shell_tunnel != "closed"
    return status.state == CONNECTED and tunnels


def video_tunnel(status: Status) -> str:
    """Return the video tunnel's state for a person."""
    if status.video_tunnel == "unwatched":
        return "closed until somebody watches"
    return status.video_tunnel


def _mac(status: Status) -> str:
    if not status.mac:
        return "(not known yet)"
    return f"{status.mac} ({status.interface or 'no interface of this machine has it now'})"


def _end_to_end(status: Status) -> str:
    return ", ".join(f"{name} {state}" for name, state in end_to_end(status).items())


def end_to_end(status: Status) -> dict[str, str]:
    """Return how the server reaches the robot's services: what is down on the robot is so for the server too."""
    answers = {"rosbridge": "down" if status.ros == "down" else status.end_to_end_ros}
    # Without viewers there is no tunnel for video.
    if status.video_tunnel != "unwatched":
        answers["video"] = "down" if status.video == "down" else status.end_to_end_video
    if status.shell_tunnel != "off":
        answers["shell"] = status.end_to_end_shell
    return answers


def _service(state: str, detail: str) -> str:
    return f"{state}: {detail}" if detail else state


def _when(seconds: float) -> str:
    return f"{datetime.fromtimestamp(seconds, timezone.utc):%Y-%m-%d %H:%M:%S} UTC"


def _parse(obj: JsonObject) -> Status:
    values: dict[str, str | float] = {}
    for item in fields(Status):
        if isinstance(item.default, str):
            # An agent of an earlier version, which `switch` asks too, says less.
            values[item.name] = get_text(obj, item.name, default=item.default, limit=2000)
        elif item.name in obj:
            values[item.name] = get_number(obj, item.name, -1, 1e12)
    return Status(**values)  # type: ignore[arg-type]  # each was checked against its field's default
