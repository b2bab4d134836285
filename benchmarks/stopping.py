"""How soon the robot stands when its driver is lost, for each way of losing one. Used by `bench`.

What the demo robot's own rosbridge saw on /cmd_vel tells it. Needs `make demo` and root: it drops packets with
iptables, and takes the rules away again.
"""

from __future__ import annotations

import os
import signal
import subprocess
import time
import urllib.error
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import partial

import processes
from demo import Demo
from openssh_server import wait_until
from pages import chromium, drive_live, expect_armed, log_in
from playwright.sync_api import Browser, Error, Page, sync_playwright
from program_driver import ProgramDriver
from report import Row, Section, quantiles
from sim_watch import Seen, SimWatch

ROBOT = "sim1"
ROSBRIDGE_PORT = 9090
# Longer than any stop may take, and long enough to see a robot that drives on.
WATCHED_S = 3.0
BACK_WITHIN_S = 60.0
AIM_MS = 600
LIMIT_MS = 1000
# By it tools/host_settings knows a rule that a run left which was killed.
MARK = ("-m", "comment", "--comment", "robotether-bench")


@dataclass(frozen=True)
class Stop:
    """What the robot got after a loss, in ms; `drove_on` says that a late command came, or no zero."""

    drove_on: bool
    last_command_to_zero: float | None = None
    loss_to_zero: float | None = None


def is_zero(seen: Seen) -> bool:
    return not any(value for part in seen.msg.values() for value in part.values())


def judge(commands: list[Seen], lost_at: float) -> Stop:
    """Return what one repetition showed; `commands` go on for some seconds after the loss."""
    moving = [seen.at for seen in commands if not is_zero(seen)]
    last = max(moving)
    zeros = [seen.at for seen in commands if is_zero(seen) and seen.at > last]
    if not zeros:
        return Stop(drove_on=True)
    first = min(zeros)
    # Commands that were on their way may arrive after the loss, but none after the robot was stopped.
    stopped = min((seen.at for seen in commands if is_zero(seen) and seen.at > lost_at), default=0)
    drove_on = any(at > stopped for at in moving)
    return Stop(drove_on, (first - last) * 1000, (first - lost_at) * 1000)


def watched(demo: Demo, lose: Callable[[], None]) -> Stop:
    """Wait until the robot moves, have the driver lost, and judge what /cmd_vel got until some seconds later."""
    with SimWatch(demo, ROBOT) as watch:
        wait_until(
            lambda: sum(not is_zero(seen) for seen in watch.commands()) >= 10,
            lambda: "the robot gets commands",
            within_s=10,
        )
        lost_at = time.monotonic()
        lose()
        time.sleep(WATCHED_S)
        return judge(watch.commands(), lost_at)


def program_loses(loss: Callable[[Demo, ProgramDriver, ExitStack], None], demo: Demo) -> Stop:
    with ExitStack() as undo:
        driver = undo.enter_context(ProgramDriver(drive_url(demo)))
        return watched(demo, partial(loss, demo, driver, undo))


def drive_url(demo: Demo) -> str:
    return f"wss://{demo.address}/robots/{ROBOT}/ros?ticket={demo.ticket(ROBOT, 'drive')}"


def page_loses(loss: Callable[[Browser, Page, ExitStack], None], demo: Demo) -> Stop:
    with sync_playwright() as playwright, ExitStack() as undo:
        browser = chromium(playwright)
        page = browser.new_context(ignore_https_errors=True).new_page()
        log_in(page, demo)
        drive_live(page, demo, ROBOT)
        expect_armed(page)
        page.keyboard.down("w")
        stop = watched(demo, partial(loss, browser, page, undo))
        undo.close()
        # One that was killed has nothing to close.
        with suppress(Error):
            browser.close()
        return stop


def freeze_tab(browser: Browser, _: Page, undo: ExitStack) -> None:
    """The tab's process stands still; Chromium's own way to freeze one is for tabs that nobody sees."""
    for pid in _processes(browser, "renderer"):
        os.kill(pid, signal.SIGSTOP)
        undo.callback(os.kill, pid, signal.SIGCONT)


def kill_browser(browser: Browser, _: Page, __: ExitStack) -> None:
    for pid in _processes(browser, "browser"):
        os.kill(pid, signal.SIGKILL)


def _processes(browser: Browser, kind: str) -> list[int]:
    session = browser.new_browser_cdp_session()
    processes = session.send("SystemInfo.getProcessInfo")["processInfo"]
    return [process["id"] for process in processes if process["type"] == kind]


def press_stop(demo: Demo, _: ProgramDriver, undo: ExitStack) -> None:
    undo.callback(demo.ask, "POST", f"/robots/{ROBOT}/release")
    demo.ask("POST", f"/robots/{ROBOT}/stop")


def cut_operator(_: Demo, driver: ProgramDriver, undo: ExitStack) -> None:
    port = str(driver.local_port)
    undo.enter_context(dropped("raw", "OUTPUT", "-p", "tcp", "--sport", port))
    undo.enter_context(dropped("raw", "PREROUTING", "-p", "tcp", "--dport", port))


def cut_robot(demo: Demo, _: ProgramDriver, undo: ExitStack) -> None:
    """All of the robot's packets are dropped without a word, except those of this test's own look at its rosbridge."""
    pid = str(demo.container(ROBOT).attrs["State"]["Pid"])
    inside = ("nsenter", "--net", "--target", pid)
    look = str(ROSBRIDGE_PORT)
    undo.enter_context(
        dropped("filter", "OUTPUT", "-o", "eth0", "-p", "tcp", "!", "--sport", look, at=inside)
    )
    undo.enter_context(
        dropped("filter", "INPUT", "-i", "eth0", "-p", "tcp", "!", "--dport", look, at=inside)
    )


def kill_service(service: str, demo: Demo, _: ProgramDriver, undo: ExitStack) -> None:
    container = demo.container(service)
    undo.callback(container.start)
    container.kill()


def kill_on_robot(words: str, demo: Demo, _: ProgramDriver, __: ExitStack) -> None:
    """A process on the robot dies; what starts it again is the robot's own matter."""
    pids = processes.with_words(demo.container(ROBOT), words)
    if not pids:
        raise RuntimeError(f"cannot measure: no process of {ROBOT} has {words!r} in its command")
    # The oldest: the agent has forked the others, which have its command.
    os.kill(pids[0], signal.SIGKILL)


@contextmanager
def dropped(table: str, chain: str, *what: str, at: Sequence[str] = ()) -> Iterator[None]:
    """Drop these packets inside the block, on this machine or where the command `at` goes first."""
    command, rule = [*at, "iptables", "-w", "-t", table], [*what, *MARK, "-j", "DROP"]
    subprocess.run([*command, "-I", chain, *rule], check=True)
    try:
        yield
    finally:
        subprocess.run([*command, "-D", chain, *rule], check=True)


CAUSES: Mapping[str, Callable[[Demo], Stop]] = {
    "stop pressed": partial(program_loses, press_stop),
    "page closed": partial(page_loses, lambda _, page, __: page.close()),
    "tab frozen": partial(page_loses, freeze_tab),
    "browser killed": partial(page_loses, kill_browser),
    "program's connection cut": partial(program_loses, lambda _, driver, __: driver.cut()),
    "operator's network cut": partial(program_loses, cut_operator),
    "relay killed": partial(program_loses, partial(kill_service, "relay")),
    "sshd killed": partial(program_loses, partial(kill_service, "sshd")),
    "robot's uplink cut": partial(program_loses, cut_robot),
    "agent killed": partial(program_loses, partial(kill_on_robot, "robotether_agent run")),
    "guard killed": partial(program_loses, partial(kill_on_robot, "robot-guard")),
}


def wait_drivable(demo: Demo) -> None:
    wait_until(lambda: _drives(demo), lambda: f"{ROBOT} is back", BACK_WITHIN_S, every_s=0.5)


def _drives(demo: Demo) -> bool:
    try:
        url = drive_url(demo)
    except (urllib.error.URLError, ConnectionError, TimeoutError):
        return False
    try:
        with SimWatch(demo, ROBOT) as watch, ProgramDriver(url):
            time.sleep(0.5)
            return any(not is_zero(seen) for seen in watch.commands())
    except AssertionError:
        return False


def row_of(demo: Demo, cause: str, repeat: int) -> Row:
    stops = []
    for _ in range(repeat):
        wait_drivable(demo)
        stops.append(CAUSES[cause](demo))
    times = quantiles([stop.last_command_to_zero for stop in stops], 0.5, 1, unit="ms")
    losses = quantiles([stop.loss_to_zero for stop in stops], 0.5, unit="ms")
    return {
        "cause": cause,
        "times": sum(stop.loss_to_zero is not None for stop in stops),
        **{f"last command to zero, {name}": ms for name, ms in times.items()},
        **{f"loss to zero, {name}": ms for name, ms in losses.items()},
        "continued to drive": sum(stop.drove_on for stop in stops),
    }


def measure(demo: Demo, repeat: int) -> Section:
    rows = [row_of(demo, cause, repeat) for cause in CAUSES]
    wait_drivable(demo)
    return Section(
        title="From the loss of the driver to the stopped robot",
        text=(
            "The simulated robot with `deadman_ms` 500, commands at 20 Hz.\n\n"
            f"Aim: zero on `cmd_vel` {AIM_MS} ms after the last command, never later than {LIMIT_MS} ms, and no "
            "repetition in which the robot continued to drive."
        ),
        rows=rows,
    )
