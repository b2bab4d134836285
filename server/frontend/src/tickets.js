// Gets a ticket, the permission to open one WebSocket, from the server with the login of this page.

import { csrfToken } from "./page.js";

export class TicketRefused extends Error {
  constructor(status, code = "") {
    super(`cannot get a ticket: ${status ? `the server answered ${status} ${code}` : "no answer"}`);
    this.status = status;
    this.code = code;
  }
}

const TIMEOUT_MS = 8000;

// Gives the address of the robot's WebSocket, ticket included. Throws TicketRefused.
export async function requestTicket(robot, mode) {
  const answer = await post({ robot, mode });
  const body = await answer.json().catch(() => ({}));
  if (!answer.ok) throw new TicketRefused(answer.status, body.code);
  const url = new URL(body.ros_url, location.href);
  url.protocol = url.protocol.replace("http", "ws");
  return url.href;
}

async function post(body) {
  const abort = new AbortController();
  const timer = setTimeout(() => abort.abort(), TIMEOUT_MS);
  try {
    return await fetch("/api/v1/tickets", {
      method: "POST",
      headers: { "Content-Type": "application/json", "X-CSRFToken": csrfToken() },
      body: JSON.stringify(body),
      signal: abort.signal,
    });
  } catch {
    throw new TicketRefused(0);
  } finally {
    clearTimeout(timer);
  }
}
