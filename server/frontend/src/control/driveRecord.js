// Gets the record of a drive that has just ended. The server writes it a moment later, so it is asked for some times.

const TRIES_MS = [300, 700, 1000, 2000, 3000, 3000]; // 10 s in all

// `fetchDrives(robot, fence)` gives {ok, body} as of calls.js. Gives the record, "missing" or "failed".
export async function recordOf({ robot, fence, fetchDrives, wait }) {
  let answered = false;
  for (const ms of TRIES_MS) {
    await wait(ms);
    const { ok, body } = await fetchDrives(robot, fence);
    answered ||= ok;
    const drive = ok && body.drives?.find((one) => one.fence === fence && one.ended_at);
    if (drive) return drive;
  }
  return answered ? "missing" : "failed";
}
