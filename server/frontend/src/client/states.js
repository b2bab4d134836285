// What a closed connection or a refused ticket means: the state to show, whether to try again, and in `lost`
// why this page may no longer drive.
// Pure; connection.js acts on it. Close codes are those of docs/reference/protocols.md.

import { reasons } from "../texts/common.js";

const retrying = (name, reason = "") => ({ name, reason, retry: true });
// The robot is there, but this page no longer drives it: it goes on as an observer, at once.
const lostControl = (lost) => (reason) => ({ ...retrying("connecting", reason), lost });
const final = (name, reason = "", login = false) => ({ name, reason, retry: false, login });

const BY_CLOSE_CODE = {
  1001: () => retrying("server_unreachable", reasons.restarting),
  1008: () => retrying("link_lost"),
  1009: () => retrying("link_lost"),
  // Rights or settings changed; what is left, the next ticket tells.
  4001: () => retrying("connecting"),
  4002: lostControl("superseded"),
  4003: lostControl("robot_stopped"),
  4009: lostControl("lease_held"),
  4010: lostControl("lease_lost"),
  4408: () => retrying("link_lost"),
  4413: () => retrying("link_lost"),
  4429: () => retrying("server_unreachable", reasons.crowded),
  4503: (reason) => retrying("offline", reason),
  4504: () => retrying("rosbridge_down"),
  4505: () => retrying("link_lost"),
  4510: () => retrying("lease_unavailable"),
};

export const CONNECTING = retrying("connecting");
export const LIVE = retrying("live");
export const LINK_LOST = retrying("link_lost");
export const NOT_OPENED = retrying("server_unreachable");
export const ROSBRIDGE_SILENT = retrying("rosbridge_down");

// A code that is not listed is a cut by the network (1006) or by something in between.
export function afterClose({ code, reason = "", wasLive = false }) {
  const verdict = BY_CLOSE_CODE[code];
  if (verdict) return verdict(reason);
  return retrying(wasLive ? "link_lost" : "server_unreachable");
}

// `status` 0 stands for a server that gave no answer at all.
export function afterTicketRefusal({ status, code }) {
  if (status === 401) return final("not_allowed", reasons.login, true);
  if (status === 404) return final("not_allowed", reasons.robot);
  if (code === "grant_missing") return final("not_allowed", reasons.grant);
  if (status === 400 || status === 403) return final("not_allowed", reasons.stale);
  if (status === 429) return retrying("server_unreachable", reasons.busy);
  return retrying("server_unreachable");
}
