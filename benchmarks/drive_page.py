"""The drive page in Chromium over the whole demo: its weight, first frame, smoothness, input latency. Used by `bench`.

A press without a command in 2 s ends the run, unless the page paused driving meanwhile: that is counted.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from demo import Demo
from frame_stamp import READ_STAMP
from numpy import median, quantile
from openssh_server import wait_until
from pages import chromium, drive_live, expect_live, log_in
from playwright.sync_api import Browser, Page, sync_playwright
from report import Row, Section, quantiles
from sim_watch import Seen, SimWatch
from stopping import is_zero

ROBOT = "sim1"
OPENED = 8
SECONDS = 10.0
SETTLE_MS = 3000
THROTTLE = 4
AIM_FPS = 60
FRAME = "[data-testid=stage] canvas.picture, [data-testid=view] img"
# Reads the frame once an animation frame, and notes when each new one came and how old it was, both in ms; ends after
# the given time, or with the first that can be read.
WATCH = """(ms) => new Promise((resolve) => {
  const readStamp = READ_STAMP;
  const came = [], end = performance.now() + ms;
  let last = null;
  const look = () => {
    const element = document.querySelector(`PICTURE`);
    let stamp = null;
    try { stamp = element && readStamp(element); } catch { stamp = null; }
    const now = performance.timeOrigin + performance.now();
    if (stamp !== null && stamp !== last) came.push([now, now - stamp]);
    last = stamp ?? last;
    if (ms ? performance.now() < end : came.length === 0) requestAnimationFrame(look); else resolve(came);
  };
  requestAnimationFrame(look);
})""".replace("READ_STAMP", READ_STAMP).replace("PICTURE", FRAME)
COUNT_FRAMES = """(ms) => new Promise((resolve) => {
  const gaps = [];
  let before = performance.now();
  const end = before + ms;
  const look = (now) => {
    gaps.push(now - before);
    before = now;
    if (now < end) requestAnimationFrame(look); else resolve(gaps.slice(1));
  };
  requestAnimationFrame(look);
})"""
WEIGH = """() => {
  const sizes = { document: performance.getEntriesByType("navigation")[0].transferSize };
  for (const entry of performance.getEntriesByType("resource")) {
    const kind = new URL(entry.name).pathname.split(".").pop();
    if (["css", "js", "mjs", "png", "svg", "webp", "woff2"].includes(kind)) {
      sizes[kind] = (sizes[kind] ?? 0) + entry.transferSize;
    }
  }
  return sizes;
}"""
KEY = "w"
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


def first_frame_ms(page: Page, demo: Demo) -> float:
    """Go to the fleet page, and from there to the robot by a click; ms from the click to the first frame."""
    page.goto(f"{demo.url}/")
    page.wait_for_selector(f'[data-testid=robot-card-{ROBOT}][data-online="true"]')
    link = page.get_by_test_id(f"robot-card-{ROBOT}").get_by_role("link").first
    clicked_ms = time.time() * 1000
    link.click(no_wait_after=True)
    page.wait_for_url(f"**/robots/{ROBOT}", wait_until="commit")
    return float(page.evaluate(WATCH, 0)[0][0]) - clicked_ms


def weigh(browser: Browser, demo: Demo) -> dict[str, int]:
    """Load the page as somebody who was never here; bytes of what it loads, by their kinds."""
    page = browser.new_context(ignore_https_errors=True).new_page()
    log_in(page, demo)
    session = page.context.new_cdp_session(page)
    session.send("Network.enable")
    session.send("Network.setCacheDisabled", {"cacheDisabled": True})
    page.goto(f"{demo.url}/robots/{ROBOT}", wait_until="load")
    page.wait_for_timeout(SETTLE_MS)
    sizes: dict[str, int] = page.evaluate(WEIGH)
    page.context.close()
    return sizes


def throttled_gaps_ms(page: Page, seconds: float) -> list[float]:
    session = page.context.new_cdp_session(page)
    session.send("Emulation.setCPUThrottlingRate", {"rate": THROTTLE})
    page.wait_for_timeout(SETTLE_MS)
    gaps: list[float] = page.evaluate(COUNT_FRAMES, seconds * 1000)
    return gaps


def measure(demo: Demo, seconds: float = SECONDS) -> Section:
    with sync_playwright() as playwright:
        browser = chromium(playwright)
        sizes = weigh(browser, demo)
        page = browser.new_context(ignore_https_errors=True).new_page()
        log_in(page, demo)
        first_ms = [first_frame_ms(page, demo) for _ in range(OPENED)]
        page.wait_for_timeout(SETTLE_MS)
        ages_ms = [age for _, age in page.evaluate(WATCH, seconds * 1000)]
        gaps_ms = throttled_gaps_ms(page, seconds)
        browser.close()
    parts = ", ".join(f"{kind} {size / 1000:.0f}" for kind, size in sizes.items())
    late = sum(gap > 1.5 * 1000 / AIM_FPS for gap in gaps_ms)
    ages = f"age of a frame when the page has drawn it, ms, p50 and p95 of {len(ages_ms)}"
    rows = [
        ("weight, KB", f"{sum(sizes.values()) / 1000:.1f} ({parts})", "under 200"),
        (
            f"click to first frame, ms, p50 and max of {OPENED}",
            f"{median(first_ms):.0f}, {max(first_ms):.0f}",
            "under 1000",
        ),
        (ages, f"{median(ages_ms):.0f}, {quantile(ages_ms, 0.95):.0f}", "p95 under 80"),
        (
            f"animation frames a second, processor {THROTTLE}x slower",
            1000 * len(gaps_ms) / sum(gaps_ms),
            AIM_FPS,
        ),
        (f"of {len(gaps_ms)} animation frames, more than half a frame late", late, None),
    ]
    text = (
        "Over the whole demo on loopback, with live video of 640x480 at 15 frames a second. The weight is what the "
        "page loads with an empty cache, with headers, without video and what it asks later. The first frame counts "
        "from the click on the fleet page, with a warm cache. Headless Chromium draws without a GPU, on the cores "
        "that run everything else."
    )
    columns = ("what", "measured", "aim")
    table = [dict(zip(columns, row, strict=True)) for row in rows]
    return Section("The drive page in Chromium", text, table)


def first_after(watch: SimWatch, since: float, fits: Callable[[Seen], bool], what: str) -> Seen:
    came = wait_until(
        lambda: list(filter(fits, watch.commands(since))), lambda: what, WITHIN_S, every_s=0.005
    )
    return came[0]


def unheld_press(page: Page, watch: SimWatch) -> tuple[float, float] | None:
    """Press and let go once as `press` does; None when the page held driving meanwhile."""
    expect_live(page, seconds=10)
    holds = page.evaluate("window.benchHolds")
    try:
        return press(page, watch)
    except AssertionError:
        page.keyboard.up(KEY)
        if page.evaluate("window.benchHolds") == holds:
            raise
        return None


def press(page: Page, watch: SimWatch) -> tuple[float, float]:
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


def row(event: str, took_ms: list[float]) -> Row:
    return {"event": event, "times": len(took_ms), **quantiles(took_ms, 0.5, 0.99, 1, unit="ms")}


def measure_input(demo: Demo, presses: int = PRESSES) -> Section:
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
        rows=[
            row("key down to the first command", [down for down, _ in both]),
            row("key up to the first zero", [up for _, up in both]),
        ],
    )
