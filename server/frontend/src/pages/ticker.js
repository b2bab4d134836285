// A worker of the queue page, which ticks each second: browsers slow down the timers of a hidden page, but not those of its workers.

const EVERY_MS = 1000;

setInterval(() => postMessage(null), EVERY_MS);
