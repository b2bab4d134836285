// Asks the server's API to do something, with the login of this page.

import { Api } from "../client/api.js";
import { serverClock } from "./clock.js";
import { csrfToken } from "./page.js";

export const api = new Api({
  headers: () => ({ "X-CSRFToken": csrfToken() }),
  onDate: (date) => serverClock.receive(date),
});

// As in client/api.js.
export const lease = (robot, action, more) => api.lease(robot, action, more);
export const stop = (robot) => api.stop(robot);
export const release = (robot, stopped) => api.release(robot, stopped);

// All that this user manages, or those of a site.
export const stopAll = (site) => api.post("/api/v1/stop", site ? { site } : {}, { keepalive: true });
