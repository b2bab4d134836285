"""The command `robotether-agent`: reads the command line and the environment, and runs the subcommand.

The only module that reads the environment, prints, and sets the exit code. What a person starts with sudo acts as the
agent's own user before it touches the state directory: a file that root left there would lock the boot service out of
its own state. Rights are never raised, only dropped.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import logging
import os
import pwd
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from functools import partial
from pathlib import Path

from robotether_agent import __version__, certificates  # noqa: F401 - before all that imports aiohttp
from robotether_agent.backoff import before_restart
from robotether_agent.daemon import Agent
from robotether_agent.doctor import FAIL, WARNING, fail
from robotether_agent.doctor.checks import run_checks
from robotether_agent.enrolment.enroller import Enroller, EnrolmentStore, enrolment_files, unenrol
from robotether_agent.enrolment.identity import IdentityStore
from robotether_agent.files import disk_problem, ensure_directory
from robotether_agent.guard.fork_server import ForkServer
from robotether_agent.guard.process import main as run_guard_process
from robotether_agent.problems import (
    AgentError,
    NotEnrolledError,
    ServerKeyChangedError,
    SettingsInvalidError,
    StateUnusableError,
)
from robotether_agent.settings import DEFAULT_FILE, Settings, load, settings_lines
from robotether_agent.status import CONNECTED, is_alive, read_status, render
from robotether_agent.systemd import Notifier, set_up_log
from robotether_agent.tasks import within
from robotether_agent.upgrade import Layout, Upgrade, UpgradeReport
from robotether_agent.video.encoder import availability

AGENT_USER = "robotether"
ACTIVE, REFUSED, PENDING = 0, 1, 10
# RestartPreventExitStatus of the unit: a person must look first.
NOT_RESTARTED = frozenset({ServerKeyChangedError.exit_code, SettingsInvalidError.exit_code})

log = logging.getLogger(__name__)


def act_as_agent(state_dir: Path) -> None:
    """Become the owner of `state_dir`, which is made for the user robotether if it is missing."""
    if os.geteuid() != 0:
        return
    try:
        if not state_dir.exists():
            _make(state_dir)
    except OSError as error:
        advice = "set state_dir to a place that can be written"
        what = f"cannot make the directory {state_dir}"
        raise disk_problem(what, state_dir.parent, error, advice=advice) from error
    become_owner(state_dir)


def become_owner(state_dir: Path) -> None:
    """Become the owner of `state_dir`, if root asks and there is one."""
    if os.geteuid() != 0 or not state_dir.exists():
        return
    owner = _user(state_dir.stat().st_uid)
    # In a container root itself may be the agent's user.
    if owner is not None and owner.pw_uid != 0:
        os.initgroups(owner.pw_name, owner.pw_gid)
        os.setgid(owner.pw_gid)
        os.setuid(owner.pw_uid)


def _make(state_dir: Path) -> None:
    owner = _user(AGENT_USER)
    if owner is not None:
        state_dir.mkdir(mode=0o700, parents=True)
        os.chown(state_dir, owner.pw_uid, owner.pw_gid)


def _user(who: str | int) -> pwd.struct_passwd | None:
    """Return an account; an installation without a user of its own has none."""
    try:
        return pwd.getpwuid(who) if isinstance(who, int) else pwd.getpwnam(who)
    except KeyError:
        return None


def doctor(load: Callable[[], Settings]) -> int:
    """Print all findings, and return 0 only when nothing fails."""
    try:
        settings = load()
    except SettingsInvalidError as problem:
        print(fail("settings", problem.message, problem.advice))
        return 1
    if not _may_read(settings.state_dir):
        print(fail("user", f"this user may not read {settings.state_dir}", "run this with sudo"))
        return 1
    # What root may read and write says nothing about the agent.
    become_owner(settings.state_dir)
    return asyncio.run(_run_checks(settings))


def _may_read(state_dir: Path) -> bool:
    try:
        return not state_dir.exists() or os.access(state_dir, os.R_OK | os.X_OK)
    except PermissionError:
        return False


async def _run_checks(settings: Settings) -> int:
    failed = warned = 0
    async for finding in run_checks(settings):
        print(finding, flush=True)
        failed += finding.state == FAIL
        warned += finding.state == WARNING
    well = "everything works, but see the warning" if warned else "all is well"
    print(f"{failed} of these steps failed" if failed else well)
    return 1 if failed else 0


def forget(settings: Settings, *, yes: bool) -> int:
    """Remove what makes this machine the robot that it is, after asking."""
    act_as_agent(settings.state_dir)
    files = enrolment_files(settings.state_dir)
    if not files:
        print(f"nothing to forget: {settings.state_dir} holds no key and no enrolment")
        return 0
    if not yes and not _confirmed([path.name for path in files]):
        print("nothing was removed")
        return 1
    unenrol(settings)
    print("forgotten: at its next start this machine joins as a robot of its own, with a new key")
    return 0


def _confirmed(names: list[str]) -> bool:
    print(
        f"This removes {', '.join(names)}. This cannot be undone: the server then sees a new key."
    )
    if not sys.stdin.isatty():
        print("To continue without a terminal, add --yes.")
        return False
    return input("Forget this robot? [y/N] ").strip().lower() in {"y", "yes"}


def identity(settings: Settings, *, as_json: bool, root: Path = Path("/")) -> int:
    """Print MAC and interface; without the right to keep them, print only."""
    # Anybody may look, also on a robot that is not installed yet.
    with suppress(StateUnusableError):
        act_as_agent(settings.state_dir)
        ensure_directory(settings.state_dir, "state_dir", 0o700)
    store = IdentityStore(settings, root)
    enrolment = EnrolmentStore(settings.state_dir).load(settings.server)
    identity = store.identity(enrolment.mac if enrolment else None)
    if as_json:
        print(json.dumps({**asdict(identity), "is_kept": store.is_kept(identity)}))
    else:
        absent = "" if identity.is_present else " (no interface of this machine has it now)"
        print(f"{identity.mac} {identity.interface or '-'}{absent}")
    return 0


def join(settings: Settings) -> int:
    """Join, print the answer, and return ACTIVE, PENDING, or REFUSED for all that is in the way."""
    logging.basicConfig(level=logging.WARNING, format="robotether-agent: %(message)s")
    try:
        act_as_agent(settings.state_dir)
        return asyncio.run(_join(Enroller(settings)))
    except AgentError as problem:
        print(f"robotether-agent: {problem}", file=sys.stderr)
        return REFUSED


async def _join(enroller: Enroller) -> int:
    key = await enroller.key()
    try:
        enrolment = await enroller.join()
    except NotEnrolledError as problem:
        # Whoever approves it compares this with what the server got.
        newest_key = await enroller.next_key() or key
        print(f"pending: {problem.message} (key {newest_key.fingerprint})")
        if problem.advice:
            print(problem.advice)
        return PENDING
    print(f"active: {enrolment.server} knows this robot as {enrolment.robot} (MAC {enrolment.mac})")
    return ACTIVE


def key(settings: Settings, *, prove: bool) -> int:
    """Print the public key as one line `ssh-ed25519 AAAA...`, or the proof that this robot has its private half."""
    act_as_agent(settings.state_dir)
    enroller = Enroller(settings)
    print(asyncio.run(enroller.proof()) if prove else asyncio.run(enroller.key()).public)
    return 0


def run(settings: Settings, environ: Mapping[str, str]) -> int:
    """Run the agent until it ends by itself or is asked to, and return its exit code."""
    set_up_log(settings.log_level, environ)
    notifier = Notifier.from_environ(environ)
    fork_server = None
    if settings.guard == "on":
        # Now: all that agent and guard need is imported, and no event loop runs yet.
        run_guard = partial(run_guard_process, settings.state_dir, settings.run_dir)
        fork_server = ForkServer.fork(run_guard)
    try:
        code = asyncio.run(_until_signal(settings, notifier, fork_server))
    finally:
        if fork_server is not None:
            fork_server.close()
    notifier.stopping()
    if code == 0:
        log.info("stopped")
    return code


async def _until_signal(
    settings: Settings, notifier: Notifier, fork_server: ForkServer | None
) -> int:
    """Run the agent until it ends by itself or by SIGTERM or SIGINT."""
    agent = asyncio.ensure_future(_run(settings, notifier, fork_server))
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        # Only the first one: a second cancellation would cut the orderly end short.
        loop.add_signal_handler(number, _cancel_once, agent)
    try:
        return await agent
    except asyncio.CancelledError:
        log.info("asked to stop: closed the tunnels")
        return 0


async def _run(settings: Settings, notifier: Notifier, fork_server: ForkServer | None) -> int:
    """Run the agent until it fails; return the exit code, in a service after a pause that fits."""
    rng, began_s = random.SystemRandom(), time.monotonic()
    try:
        await Agent(settings, notifier, rng, fork_server).run()
    except AgentError as problem:
        log.critical("STOPPED: %s", problem)
        code = problem.exit_code
    except Exception:
        log.exception("stopped by an error in the agent itself")
        code = 1
    else:
        return 0
    if notifier.is_service and code not in NOT_RESTARTED:
        await _pause(before_restart(time.monotonic() - began_s, rng), notifier)
    return code


async def _pause(wait_s: float, notifier: Notifier) -> None:
    notifier.status(f"failed; starts again in {wait_s:.0f} s")
    # systemd must not take the pause for a hanging loop.
    with suppress(asyncio.TimeoutError):
        await within(wait_s, notifier.keep_watchdog())


def _cancel_once(agent: asyncio.Future[int]) -> None:
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.remove_signal_handler(number)
        signal.signal(number, signal.SIG_IGN)
    agent.cancel()


def status(settings: Settings, *, as_json: bool) -> int:
    """Print the status, and return 0 only when the robot is connected."""
    report, now = read_status(settings.run_dir), time.time()
    alive = report is not None and is_alive(report, now)
    if as_json:
        print(json.dumps({**(asdict(report) if report else {}), "is_running": alive}))
    elif report is None:
        print(f"state         not running (no status in {settings.run_dir})")
        print("what to do    start it: sudo systemctl start robotether-agent")
    else:
        print(render(report, now, availability(settings.video_encoder)))
    return 0 if report is not None and alive and report.state == CONNECTED else 1


def switch(settings: Settings, directory: Path, wait_s: float) -> int:
    """Switch, print what came of it, and return 0 only when the other version is in use."""
    # The terminal that asked may go away with the tunnel.
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    target = directory.absolute()
    return _print_report(Upgrade(Layout(target.parent.parent), settings.run_dir, wait_s).to(target))


def finish_switch(settings: Settings, was: Path, target: Path, state: str, wait_s: float) -> int:
    """Switch from `was` to `target` again; `state` is how the agent was before."""
    change = Upgrade(Layout(target.parent.parent), settings.run_dir, wait_s)
    return _print_report(change.finish(was, target, state))


def install_video(wheelhouse: Path | None) -> int:
    """Add PyAV to this version, and print what came of it."""
    # A process of its own: what installs is no part of the agent.
    command = [sys.executable, "-m", "robotether_agent.install_video"]
    if wheelhouse is not None:
        command += ["--no-index", "--find-links", str(wheelhouse.absolute())]
    done = subprocess.run(command, stderr=subprocess.PIPE, text=True, check=False)  # noqa: S603
    if done.returncode:
        print(f"robotether-agent: cannot install PyAV: {done.stderr.strip()}", file=sys.stderr)
        return 1
    print("PyAV is installed")
    return 0


def _print_report(report: UpgradeReport) -> int:
    print(f"{report.result}: {report.detail}")
    return 0 if report.result == "done" else 1


def main(arguments: Sequence[str] | None = None, environ: Mapping[str, str] = os.environ) -> int:
    """Run the command and return its exit code."""
    options = _parser().parse_args(arguments)
    try:
        if options.command == "doctor":
            return doctor(partial(load, options.config, environ))
        if options.command == "install-video":
            return install_video(options.wheelhouse)
        settings = load(options.config, environ, needs_server=options.command not in WITHOUT_SERVER)
        return COMMANDS[options.command](settings, options, environ)
    except AgentError as problem:
        print(f"robotether-agent: {problem}", file=sys.stderr)
        return problem.exit_code


def _show_settings(settings: Settings) -> int:
    print("\n".join(settings_lines(settings)))
    return 0


Command = Callable[[Settings, argparse.Namespace, Mapping[str, str]], int]
COMMANDS: dict[str, Command] = {
    "run": lambda settings, _, environ: run(settings, environ),
    "status": lambda settings, options, _: status(settings, as_json=options.json),
    "join": lambda settings, *_: join(settings),
    "identity": lambda settings, options, _: identity(settings, as_json=options.json),
    "key": lambda settings, options, _: key(settings, prove=options.prove),
    "forget": lambda settings, options, _: forget(settings, yes=options.yes),
    "switch": lambda settings, options, _: switch(settings, options.directory, options.wait),
    "finish-switch": lambda settings, options, _: finish_switch(
        settings, options.was, options.directory, options.state, options.wait
    ),
    "show-settings": lambda settings, *_: _show_settings(settings),
}
# Commands that an installer runs before it knows the server.
WITHOUT_SERVER = frozenset({"identity", "key", "forget"})


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="robotether-agent",
        description="Keeps this robot's tunnel to its Robotether server open.",
    )
    parser.add_argument("--version", action="version", version=f"robotether-agent {__version__}")
    parser.add_argument("--config", type=Path, help=f"settings file (usually {DEFAULT_FILE})")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    commands.add_parser("run", help="connect and stay connected; the boot service runs this")
    state = commands.add_parser(
        "status", help="show the state of the running agent; 0 when connected"
    )
    state.add_argument("--json", action="store_true", help="for programs")
    commands.add_parser("join", help="ask the server once: 0 active, 10 pending, 1 refused")
    commands.add_parser("doctor", help="check every step, and print what to do; 0 if all is well")
    named = commands.add_parser("identity", help="print the MAC that names this robot")
    named.add_argument("--json", action="store_true", help="for programs")
    public = commands.add_parser(
        "key", help="create the robot's key if there is none, print its public half"
    )
    public.add_argument("--prove", action="store_true", help="print its signature over MAC and key")
    forget_parser = commands.add_parser(
        "forget", help="remove key and enrolment, so that a disk can be copied"
    )
    forget_parser.add_argument("--yes", action="store_true", help="do not ask")
    other = commands.add_parser("switch", help="switch to another version, or roll back by itself")
    other.add_argument("directory", type=Path, help="such as /opt/robotether-agent/versions/NAME")
    other.add_argument("--wait", type=float, default=60.0, metavar="S", help="usually 60 s")
    video = commands.add_parser("install-video", help="install PyAV, which encodes H.264")
    video.add_argument(
        "--wheelhouse", type=Path, metavar="DIR", help="take it from this folder, not the internet"
    )
    # Without a help text it is not listed: a unit starts it, no person.
    again = commands.add_parser("finish-switch")
    again.add_argument("was", type=Path)
    again.add_argument("directory", type=Path)
    again.add_argument("state")
    again.add_argument("--wait", type=float, default=60.0, metavar="S")
    commands.add_parser("show-settings", help="print the settings in force, secrets hidden")
    return parser
