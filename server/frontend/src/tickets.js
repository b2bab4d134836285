// Gets a ticket, the permission to open one WebSocket, from the server with the login of this page.

import { post } from "./calls.js";

export class TicketRefused extends Error {
  constructor(status, code = "") {
    super(`cannot get a ticket: ${status ? `the server answered ${status} ${code}` : "no answer"}`);
    this.status = status;
    this.code = code;
  }
}

// Gives the address of the robot's WebSocket, ticket included. Throws TicketRefused.
export async function requestTicket(robot, mode) {
  const { ok, status, code, body } = await post("/api/v1/tickets", { robot, mode });
  if (!ok) throw new TicketRefused(status, code);
  const url = new URL(body.ros_url, location.href);
  url.protocol = url.protocol.replace("http", "ws");
  return url.href;
}
