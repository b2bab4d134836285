// Delays between attempts, in milliseconds: doubling from 0.5 s to 5 s. Jitter keeps the browsers of
// a whole site from coming back in the same instant after the server restarted.

const FIRST_MS = 500;
const LAST_MS = 5000;

export function* backoff(random = Math.random) {
  for (let full = FIRST_MS; ; full = Math.min(2 * full, LAST_MS)) {
    yield Math.max(FIRST_MS, full * (0.5 + random() / 2));
  }
}
