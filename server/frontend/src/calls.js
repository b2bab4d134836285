// Asks the server's API to do something, with the login of this page. Never throws: no answer is an answer, too.

import { serverClock } from "./clock.js";
import { csrfToken } from "./page.js";

const TIMEOUT_MS = 8000;

// Gives {status, ok, code, detail, body}; `status` 0 is no answer. `keepalive` lets it outlive the page.
export async function post(path, body = {}, { keepalive = false, timeoutMs = TIMEOUT_MS } = {}) {
  const abort = new AbortController();
  const timer = setTimeout(() => abort.abort(), timeoutMs);
  try {
    const answer = await fetch(path, {
      method: "POST",
      headers: { "Content-Type": "application/json", "X-CSRFToken": csrfToken() },
      body: JSON.stringify(body),
      signal: abort.signal,
      keepalive,
    });
    serverClock.hear(answer.headers.get("Date"));
    return await read(answer);
  } catch {
    return { status: 0, ok: false, code: "", detail: "", body: {} };
  } finally {
    clearTimeout(timer);
  }
}

async function read(answer) {
  const { status, ok } = answer;
  const body = (await answer.json().catch(() => null)) ?? {};
  return { status, ok, code: body.code ?? "", detail: body.detail ?? "", body };
}

const path = (robot, deed) => `/api/v1/robots/${encodeURIComponent(robot)}/${deed}`;

// `action` is ask, withdraw, hand_over, refuse or take; `more` may say to whom.
export const lease = (robot, action, more = {}) => post(path(robot, "lease"), { action, ...more });

export const stop = (robot) => post(path(robot, "stop"), {}, { keepalive: true, timeoutMs: 3000 });

// `stopped` as in the control object: no other stop is released.
export const release = (robot, { by, at }) => post(path(robot, "release"), { by, at });

// All that this user manages, or those of a site.
export const stopAll = (site) => post("/api/v1/stop", site ? { site } : {}, { keepalive: true });
