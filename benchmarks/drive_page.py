"""What the drive page weighs, how soon it shows a frame, how old that is on the screen, and whether it runs smoothly.

Chromium over the whole demo on loopback. The first picture is the first whose moment can be read out of what the page
shows; smoothness is counted in animation frames while the processor is throttled to a quarter. Used by `bench`; needs
`make demo`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from demo import Demo
from frame_stamp import READ_STAMP
from pages import chromium, log_in
from playwright.sync_api import Browser, CDPSession, Page, sync_playwright
from sections import Section, quantile

ROBOT = "sim1"
OPENED = 8
SECONDS = 10.0
SETTLE_MS = 3000
THROTTLE = 4
FIRST_WITHIN_MS, POLL_EVERY_MS = 15_000, 100
BINARY = 2
AIM_KB, AIM_FIRST_MS, AIM_FPS = 200, 1000, 60
FRAME = "[data-testid=stage] canvas.picture, [data-testid=view] img"

# In each page before its own scripts: the click on the fleet page, then the first readable picture on the drive page.
WATCH_FIRST = """(() => {
  const unix = (ms) => performance.timeOrigin + ms;
  addEventListener("click", (event) => sessionStorage.setItem("benchClick", unix(event.timeStamp)), { capture: true });
  if (!location.pathname.startsWith("/robots/")) return;
  const readStamp = READ_STAMP;
  const look = () => {
    const element = document.querySelector(`PICTURE`);
    let stamp = null;
    try { stamp = element && readStamp(element); } catch { stamp = null; }
    if (stamp === null) return requestAnimationFrame(look);
    window.benchFirstMs = unix(performance.now()) - Number(sessionStorage.getItem("benchClick"));
  };
  requestAnimationFrame(look);
})()""".replace("READ_STAMP", READ_STAMP).replace("PICTURE", FRAME)

# Reads the picture once an animation frame, and notes the age of each new one.
WATCH_AGES = """(ms) => new Promise((resolve) => {
  const readStamp = READ_STAMP;
  const element = document.querySelector(`PICTURE`);
  const ages = [], end = performance.now() + ms;
  let last = null;
  const look = () => {
    const stamp = readStamp(element);
    if (stamp !== null && stamp !== last) ages.push(performance.timeOrigin + performance.now() - stamp);
    last = stamp ?? last;
    if (performance.now() < end) requestAnimationFrame(look); else resolve(ages);
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


@dataclass
class Weight:
    """What came over the wire for the page itself; pictures and what the page asks later are not the page."""

    kinds: dict[str, str] = field(default_factory=dict)
    bytes_by_kind: dict[str, int] = field(default_factory=dict)

    def listen(self, session: CDPSession) -> None:
        """Count from now on, without a cache."""
        session.on("Network.responseReceived", self._on_response)
        session.on("Network.loadingFinished", self._on_finished)
        session.send("Network.enable")
        session.send("Network.setCacheDisabled", {"cacheDisabled": True})

    @property
    def total_kb(self) -> float:
        """All of it."""
        return sum(self.bytes_by_kind.values()) / 1000

    def _on_response(self, event: dict[str, Any]) -> None:
        if "/video/" not in event["response"]["url"]:
            self.kinds[event["requestId"]] = event["type"]

    def _on_finished(self, event: dict[str, Any]) -> None:
        kind = self.kinds.get(event["requestId"])
        if kind in {"Document", "Stylesheet", "Script", "Image", "Font"}:
            size = int(event["encodedDataLength"])
            self.bytes_by_kind[kind] = self.bytes_by_kind.get(kind, 0) + size


@dataclass
class Result:
    """What was measured."""

    weight: Weight
    first_ms: list[float]
    ages_ms: list[float]
    gaps_ms: list[float]
    frames_per_s: float

    @property
    def fps(self) -> float:
        """Animation frames a second, throttled."""
        return 1000 * len(self.gaps_ms) / sum(self.gaps_ms)


def open_by_click(page: Page, demo: Demo) -> None:
    """Go to the fleet page, and from there to the robot by a click."""
    page.goto(f"{demo.url}/")
    link = page.get_by_test_id(f"robot-card-{ROBOT}").get_by_role("link").first
    page.wait_for_selector(f'[data-testid=robot-card-{ROBOT}][data-online="true"]')
    link.click()
    page.wait_for_url(f"**/robots/{ROBOT}")


def first_frame_ms(page: Page, demo: Demo) -> float:
    """Ms from the click to a picture."""
    open_by_click(page, demo)
    # Not by wait_for_function, whose eval the page's policy forbids.
    for _ in range(FIRST_WITHIN_MS // POLL_EVERY_MS):
        first = page.evaluate("window.benchFirstMs")
        if first is not None:
            return float(first)
        page.wait_for_timeout(POLL_EVERY_MS)
    raise RuntimeError(f"cannot measure: no frame in {FIRST_WITHIN_MS} ms")


def weigh(browser: Browser, demo: Demo) -> Weight:
    """Load the page as somebody who was never here."""
    page = browser.new_context(ignore_https_errors=True).new_page()
    log_in(page, demo)
    weight = Weight()
    weight.listen(page.context.new_cdp_session(page))
    page.goto(f"{demo.url}/robots/{ROBOT}", wait_until="load")
    page.wait_for_timeout(SETTLE_MS)
    page.context.close()
    return weight


def throttled(page: Page, seconds: float) -> tuple[list[float], float]:
    """The gaps between animation frames on a slow processor, and the pictures a second that came meanwhile."""
    session = page.context.new_cdp_session(page)
    frames: list[int] = []

    def note(event: dict[str, Any]) -> None:
        if event["response"]["opcode"] == BINARY:
            frames.append(len(event["response"]["payloadData"]))

    session.on("Network.webSocketFrameReceived", note)
    session.send("Emulation.setCPUThrottlingRate", {"rate": THROTTLE})
    page.wait_for_timeout(SETTLE_MS)
    gaps = page.evaluate(COUNT_FRAMES, seconds * 1000)
    # The browser tells of each message at a cost, so they are counted in a while of its own.
    session.send("Network.enable")
    frames.clear()
    page.wait_for_timeout(SETTLE_MS)
    rate = len(frames) / SETTLE_MS * 1000
    session.send("Emulation.setCPUThrottlingRate", {"rate": 1})
    return gaps, rate


def measure_all(demo: Demo, seconds: float) -> Result:
    """Weigh, open, watch."""
    with sync_playwright() as playwright:
        browser = chromium(playwright)
        weight = weigh(browser, demo)
        context = browser.new_context(ignore_https_errors=True)
        page = context.new_page()
        log_in(page, demo)
        context.add_init_script(WATCH_FIRST)
        first_ms = [first_frame_ms(page, demo) for _ in range(OPENED)]
        page.wait_for_timeout(SETTLE_MS)
        ages_ms = page.evaluate(WATCH_AGES, seconds * 1000)
        gaps_ms, frames_per_s = throttled(page, seconds)
        browser.close()
    return Result(weight, first_ms, ages_ms, gaps_ms, frames_per_s)


def measure(demo: Demo, seconds: float = SECONDS) -> Section:
    """Measure, and return the result."""
    found = measure_all(demo, seconds)
    parts = ", ".join(
        f"{kind.lower()} {size / 1000:.0f}" for kind, size in found.weight.bytes_by_kind.items()
    )
    late = sum(gap > 1.5 * 1000 / AIM_FPS for gap in found.gaps_ms)
    return Section(
        title="The drive page in Chromium",
        text=(
            "Over the whole demo on loopback, with live video of 640x480 at 15 frames a second. The weight is what the "
            "page loads with an empty cache, with headers, without video. The first frame counts from the click on the "
            "fleet page, with a warm cache. Headless Chromium draws without a GPU, on the cores that run everything "
            "else."
        ),
        table=[
            "| what | measured | aim |",
            "|---|---|---|",
            f"| weight, KB | {found.weight.total_kb:.1f} ({parts}) | under {AIM_KB} |",
            f"| click to first frame, ms, p50 and max of {len(found.first_ms)} "
            f"| {quantile(found.first_ms, 0.5):.0f}, {max(found.first_ms):.0f} | under {AIM_FIRST_MS} |",
            f"| age of a frame when the page has drawn it, ms, p50 and p95 of {len(found.ages_ms)} "
            f"| {quantile(found.ages_ms, 0.5):.0f}, {quantile(found.ages_ms, 0.95):.0f} | p95 under 80 |",
            f"| animation frames a second, processor {THROTTLE}x slower | {found.fps:.1f} | {AIM_FPS} |",
            f"| of {len(found.gaps_ms)} animation frames, more than half a frame late | {late} | - |",
            f"| video frames a second meanwhile | {found.frames_per_s:.1f} | 15 |",
        ],
    )
