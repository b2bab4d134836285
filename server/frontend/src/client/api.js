// How a page reaches the server: its API, tickets, the addresses of WebSockets and streams, and delays between attempts.

import { reasons } from "../texts/common.js";

// Asks the API to do something. Never throws: no answer is an answer, too.
const TIMEOUT_MS = 8000;
const NO_ANSWER = { status: 0, ok: false, code: "", detail: "", body: {} };

export class Api {
  // `server` is "" for the page's own; `headers()` are those that say who asks. `onDate` gets each answer's header Date.
  /** @param {{server?: string, headers?: () => Record<string, string>, onDate?: (date: string | null) => void}} options */
  constructor({ server = "", headers = () => ({}), onDate = () => {} } = {}) {
    this.server = server;
    this.headers = headers;
    this.onDate = onDate;
  }

  // Gives {status, ok, code, detail, body}; `status` 0 is no answer of the server. `keepalive` lets it outlive the page.
  post(path, body = {}, options = {}) {
    return this.send("POST", path, body, options);
  }

  put(path, body = {}, options = {}) {
    return this.send("PUT", path, body, options);
  }

  send(method, path, body, options) {
    const headers = { "Content-Type": "application/json" };
    return this.ask(path, { method, headers, body: JSON.stringify(body) }, options);
  }

  get(path, query = {}, options = {}) {
    return this.ask(withQuery(path, query), { method: "GET" }, options);
  }

  async ask(path, request, { keepalive = false, timeoutMs = TIMEOUT_MS } = {}) {
    try {
      return await withTimeLimit(timeoutMs, async (signal) => {
        const headers = { ...request.headers, ...this.headers() };
        const answer = await fetch(this.server + path, { ...request, headers, signal, keepalive });
        this.onDate(answer.headers.get("Date"));
        return (await readAnswer(answer)) ?? { ...NO_ANSWER, detail: reasons.between };
      });
    } catch {
      return NO_ANSWER;
    }
  }

  // `action` is ask, withdraw, hand_over, refuse or take; `more` may say to whom. `mac`: of the robot meant, as another one may
  // have its name by now, beside the body, which a machine of an older version would refuse with it.
  lease(robot, action, more = {}, mac = undefined) {
    return this.post(robotPath(robot, "lease", { mac }), { action, ...more });
  }

  // `press` as of Session.stopRobot.
  stop(robot, press, mac) {
    return this.post(robotPath(robot, "stop", { press, mac }), {}, { keepalive: true, timeoutMs: 3000 });
  }

  // The server answers by itself after `wait_s`, or 5 s.
  topic(robot, topic, query) {
    return this.get(robotPath(robot, `topics/${encodeURIComponent(topic)}`), query, waitFor(query.wait_s));
  }

  service(robot, service, args, query) {
    return this.post(robotPath(robot, `services/${encodeURIComponent(service)}`, query), args, waitFor(query.timeout_s));
  }

  uplink(robot, mac) {
    return this.get(robotPath(robot, "uplink", { mac }));
  }

  // `stopped` as in the control object: no other stop is released.
  release(robot, { by, at }, mac = undefined) {
    return this.post(robotPath(robot, "release", { mac }), { by, at });
  }
}

// Gives what `act(signal)` does, and aborts what goes on after this time: Safari 15 has no AbortSignal.timeout.
export async function withTimeLimit(ms, act, abort = new AbortController()) {
  const timer = setTimeout(() => abort.abort(), ms);
  try {
    return await act(abort.signal);
  } finally {
    clearTimeout(timer);
  }
}

// That of the login of a page of the server's own.
/** @returns {string} */
export const csrfToken = () => /** @type {HTMLMetaElement} */ (document.querySelector('meta[name="csrf-token"]')).content;

// The headers of the caller: a token, or the login of a page of the server's own.
export function credentials(token) {
  return () => /** @type {Record<string, string>} */ (token ? { Authorization: `Bearer ${token}` } : { "X-CSRFToken": csrfToken() });
}

// Gives what `ask` does; null for what the server never writes, as the page of a proxy that answers in its place.
async function readAnswer(answer) {
  const { status, ok } = answer;
  const body = status === NO_CONTENT ? {} : await answer.json().catch(() => null);
  return body && { status, ok, code: body.code ?? "", detail: body.detail ?? "", body };
}

const NO_CONTENT = 204;
const MAX_WORDS = 300;

// Why an answer is none, as `ask` gives it: the relay's own, or the sentence of the robot's agent.
export async function readRefusal(answer) {
  const isText = answer.headers.get("Content-Type")?.startsWith("text/plain");
  if (!isText) return (await readAnswer(answer)) ?? { ...NO_ANSWER, status: answer.status };
  const words = (await answer.text().catch(() => "")).trim();
  return { status: answer.status, code: "", detail: words.slice(0, MAX_WORDS) };
}

function withQuery(path, query) {
  const words = defined(query);
  return words.length ? `${path}?${new URLSearchParams(words)}` : path;
}

const waitFor = (seconds = 5) => ({ timeoutMs: TIMEOUT_MS + seconds * 1000 });

export const robotPath = (robot, action, query = {}) => withQuery(`/api/v1/robots/${encodeURIComponent(robot)}/${action}`, query);

// Gets a ticket, the permission to open one WebSocket, from the server.
export class TicketRefused extends Error {
  constructor(status, code = "", detail = "") {
    super(`cannot get a ticket: ${status ? `the server answered ${status} ${code}` : "no answer"}`);
    this.status = status;
    this.code = code;
    this.detail = detail;
  }
}

// `api` is an Api, `more` may have the MAC of the robot that is meant. Both throw TicketRefused.
export const requestTicket = (api, robot, mode, more = {}) => askForTicket(api, "/api/v1/tickets", { robot, mode, ...more });
export const appTicket = (api, app) => askForTicket(api, "/api/v1/tickets/app", { app });

async function askForTicket(api, path, wish) {
  const { ok, status, code, detail, body } = await api.post(path, wish);
  if (!ok) throw new TicketRefused(status, code, detail);
  return body.ticket;
}

// A ticket that a function of the page gives, from a backend of its own. Throws TicketRefused.
export async function ticketBy(getTicket, wish) {
  try {
    return await getTicket(wish);
  } catch (/** @type {any} */ error) {
    throw error instanceof TicketRefused ? error : new TicketRefused(error?.status ?? 0, error?.code, error?.detail);
  }
}

// Where a robot's WebSockets and streams are (docs/reference/protocols.md, docs/reference/media.md). Pure.

const defined = (query) => Object.entries(query).filter(([, value]) => value !== undefined);

// A query with its slashes as they are: web_video_server takes what stands there for the topic and undoes no escapes.
const plainQuery = (query) => new URLSearchParams(defined(query)).toString().replaceAll("%2F", "/");

// `server` is https://HOST[:PORT]; `ticket` may be missing where a login does.
export const rosUrl = (server, robot, ticket) => address(server, of(robot, "ros"), { ticket }, true);

export const appUrl = (server, app, ticket) => address(server, `apps/${app}/ros`, { ticket }, true);

export const framesUrl = (server, robot, topic, { ticket, mac } = /** @type {any} */ ({})) =>
  address(server, of(robot, "video/frames"), { topic, ticket, mac }, true);

export const streamUrl = (server, robot, topic, ticket, more = {}) =>
  address(server, of(robot, "video/stream"), { topic, ...more, ticket });

// A still of a camera; with no topic among `words` of the robot's first. Its agent makes it of any source.
export const snapshotUrl = (robot, words) => `/${of(robot, "video/robotether/snapshot")}?${plainQuery(words)}`;

const of = (robot, path) => `robots/${encodeURIComponent(robot)}/${path}`;

function address(server, path, query, socket = false) {
  const url = new URL(`/${path}`, server);
  url.search = plainQuery(query);
  if (socket) url.protocol = url.protocol.replace("http", "ws");
  return url.href;
}

// Delays between attempts, in milliseconds: doubling from 0.5 s to 5 s. Jitter keeps the browsers of
// a whole site from coming back in the same instant after the server restarted.
const FIRST_MS = 500;
const LAST_MS = 5000;

/** @returns {Generator<number, never>} */
export function* backoff(random = Math.random) {
  for (let full = FIRST_MS; ; full = Math.min(2 * full, LAST_MS)) {
    yield Math.max(FIRST_MS, full * (0.5 + random() / 2));
  }
}
