// Gets a ticket, the permission to open one WebSocket, from the server.

export class TicketRefused extends Error {
  constructor(status, code = "") {
    super(`cannot get a ticket: ${status ? `the server answered ${status} ${code}` : "no answer"}`);
    this.status = status;
    this.code = code;
  }
}

// `api` as of client/api.js. Throws TicketRefused.
export async function requestTicket(api, robot, mode) {
  const { ok, status, code, body } = await api.post("/api/v1/tickets", { robot, mode });
  if (!ok) throw new TicketRefused(status, code);
  return body.ticket;
}
