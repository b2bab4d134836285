"""How long it takes from a key event in Chromium to the command on the robot's /cmd_vel, on loopback.

A person's page over the whole demo; W is pressed and let go again and again. The event's own time stamp is the
beginning; the end is the moment in which a subscriber of the robot's own rosbridge has the command, so that
rosbridge's own time is in it. Used by `bench`; needs `make demo`. A press that brings no command in 2 s ends the run,
unless the page held driving meanwhile, as it does when the picture is old: that is counted and shown.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from demo import Demo
from pages import chromium, drive_live, expect_live, log_in
from playwright.sync_api import Page, sync_playwright
from sections import Section, quantile
from sim_watch import Seen, SimWatch
from stopping import is_zero

ROBOT, KEY = "sim1", "w"
PRESSES = 80
HELD_S = 0.12
# Longer than the zeros after a release last, so that each press begins from silence.
PAUSE_S = 0.25
WITHIN_S = 2.0
AIM_P50_MS, AIM_P99_MS = 5, 20

# Unix time in ms of the last events, by the page's own clocks; capture, so that no listener of the page comes first.
LISTEN = """(() => {
  window.benchKeys = {};
  const note = (event) => {
    if (!event.repeat) window.benchKeys[event.type] = performance.timeOrigin + event.timeStamp;
  };
  for (const type of ["keydown", "keyup"]) addEventListener(type, note, { capture: true });
  const state = document.querySelector("[data-testid=state]");
  window.benchHolds = 0;
  new MutationObserver(() => { window.benchHolds += state.dataset.shown === "held"; })
    .observe(state, { attributeFilter: ["data-shown"] });
})()"""


def first_after(watch: SimWatch, since: float, fits: Callable[[Seen], bool], what: str) -> Seen:
    """Wait for the first fitting command that came after `since`."""
    end = time.monotonic() + WITHIN_S
    while time.monotonic() < end:
        for seen in watch.commands(since):
            if fits(seen):
                return seen
        time.sleep(0.005)
    raise RuntimeError(f"cannot measure: no {what} on /cmd_vel within {WITHIN_S:g} s")


def unheld_press(page: Page, watch: SimWatch) -> tuple[float, float] | None:
    """Press and let go once as `press` does; None when the page held driving meanwhile."""
    expect_live(page, seconds=10)
    holds = page.evaluate("window.benchHolds")
    try:
        return press(page, watch)
    except RuntimeError:
        page.keyboard.up(KEY)
        if page.evaluate("window.benchHolds") == holds:
            raise
        return None


def press(page: Page, watch: SimWatch) -> tuple[float, float]:
    """Press and let go once: ms from the event to the command, for both."""
    # Of one pair of clocks, as they may drift apart.
    to_unix_ms = (time.time() - time.monotonic()) * 1000
    since = time.monotonic()
    page.keyboard.down(KEY)
    moved = first_after(watch, since, lambda seen: not is_zero(seen), "command")
    page.wait_for_timeout(HELD_S * 1000)
    since = time.monotonic()
    page.keyboard.up(KEY)
    stood = first_after(watch, since, is_zero, "zero")
    keys = page.evaluate("window.benchKeys")
    page.wait_for_timeout(PAUSE_S * 1000)
    return (
        moved.at * 1000 + to_unix_ms - keys["keydown"],
        stood.at * 1000 + to_unix_ms - keys["keyup"],
    )


def row(event: str, took_ms: list[float]) -> str:
    """A line of the table."""
    return (
        f"| {event} | {len(took_ms)} | {quantile(took_ms, 0.5):.1f} | {quantile(took_ms, 0.99):.1f} "
        f"| {max(took_ms):.1f} |"
    )


def measure(demo: Demo, presses: int = PRESSES) -> Section:
    """Press so often."""
    with sync_playwright() as playwright:
        browser = chromium(playwright)
        page = browser.new_context(ignore_https_errors=True).new_page()
        log_in(page, demo)
        drive_live(page, demo, ROBOT)
        page.wait_for_timeout(1000)
        page.evaluate(LISTEN)
        with SimWatch(demo, ROBOT) as watch:
            tried = [unheld_press(page, watch) for _ in range(presses)]
        browser.close()
    both = [times for times in tried if times is not None]
    if not both:
        raise RuntimeError("cannot measure: the page paused driving at each press")
    return Section(
        title="From a key event to `cmd_vel` on the robot",
        text=(
            f"W is pressed and released {presses} times on the drive page in Chromium, with live video, over the "
            "whole demo on loopback. The time is from the event's timestamp until a subscriber of the robot's "
            f"rosbridge has the command. During {len(tried) - len(both)} presses the page paused driving because the "
            "video was old.\n\n"
            f"Aim: p50 under {AIM_P50_MS} ms and p99 under {AIM_P99_MS} ms."
        ),
        table=[
            "| event | times | p50 ms | p99 ms | max ms |",
            "|---|---|---|---|---|",
            row("key down to the first command", [down for down, _ in both]),
            row("key up to the first zero", [up for _, up in both]),
        ],
    )
