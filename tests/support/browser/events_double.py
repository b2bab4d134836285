"""A double of /api/v1/events inside a page: a fleet of robots all online, whose round trips change all the time.

Real robots of that number do not fit this machine; the page reads what it would from the server.
"""

from __future__ import annotations

from playwright.sync_api import Page

# `everyMs` apart, one robot after the other gets another round trip; each tenth of these also its battery or driver.
SCRIPT = """([count, everyMs]) => {
  const original = window.fetch;
  const robot = (i) => ({
    name: `crowd-${String(i).padStart(3, "0")}`, state: "active", online: true, since: "2026-01-01T12:00:00Z",
    rtt_ms: 10 + (i % 90), ros: i % 25 ? "ok" : "down", video: "ok", drivers: [], observers: 0, site: `site-${i % 7}`,
    battery: { percent: i % 100, charging: false },
    control: { driver: i % 9 ? null : { user: "ann", since: "2026-01-01T12:00:00Z", fence: 1 }, waiting: null,
               reserved: null, stopped: null, guard: "ready" },
  });
  const all = Array.from({ length: count }, (_, i) => robot(i));
  const event = (name, data) => new TextEncoder().encode(`event: ${name}\\ndata: ${JSON.stringify(data)}\\n\\n`);
  window.eventsTold = 0;
  const stream = () => new ReadableStream({
    start(controller) {
      controller.enqueue(event("fleet", all));
      let next = 0;
      let owed = performance.now();
      setInterval(() => {
        for (; owed < performance.now(); owed += everyMs, next += 1) {
          const one = all[next % count];
          one.rtt_ms = 10 + ((one.rtt_ms * 7 + next) % 90);
          if (next % 10 === 0) one.battery.percent = (one.battery.percent + 1) % 100;
          if (next % 40 === 0) one.control.driver = one.control.driver ? null : { user: "ben", since: null, fence: 2 };
          controller.enqueue(event("robot", one));
          window.eventsTold += 1;
        }
      }, 20);
    },
  });
  window.fetch = (url, ...more) => String(url).endsWith("/api/v1/events")
    ? Promise.resolve(new Response(stream(), { headers: { "Content-Type": "text/event-stream" } }))
    : original(url, ...more);
}"""


def double_events(page: Page, *, robots: int, every_ms: float) -> None:
    """Have pages that are opened from now on hear of this fleet, in place of the server's."""
    page.add_init_script(f"({SCRIPT})({[robots, every_ms]})")
