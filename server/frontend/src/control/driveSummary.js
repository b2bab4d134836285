// The summary of this page's last drive: in words, and as a file.

import { api } from "../dom/calls.js";
import { download, durationText, make, part, setText, shortNumber, sizeText } from "../dom/page.js";
import { summary as texts, endReasons } from "../texts/panels.js";

const fetchDrives = (mac, fence) => api.get("/api/v1/drives", { mac, fence });
const wait = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

export class Summary {
  // `root` is the panel over the video, a <details>, with the server's words in data-words: JSON, {ends, refusals} by their codes.
  // `me` is the user's name.
  constructor(root, { robot, mac, me }) {
    this.root = root;
    this.robot = robot;
    this.mac = mac;
    this.me = me;
    this.serverWords = JSON.parse(root.dataset.words);
    /** @type {number | null} */
    this.fence = null; // of this page's drive: the number of its lease
    this.driving = false;
    this.round = 0;
    part(root, "summary-save").addEventListener("click", () => this.save());
    part(root, "summary-close").addEventListener("click", () => (root.hidden = true));
  }

  // What the page's own connection reports of control. Its first report that names this user means this page:
  // the server gives a drive its number before it opens the connection. A later one may be another window's.
  receive({ driver }, driving) {
    if (this.fence === null && driving && driver?.user === this.me) this.fence = driver.fence;
  }

  // The page's own connection has ended, and with it the drive.
  linkEnded() {
    const { fence } = this;
    this.fence = null;
    if (fence !== null) this.driveEnded(fence);
  }

  // A person who drives again needs the video.
  use({ live, driving }) {
    const drives = live && driving;
    if (drives && !this.driving) this.root.hidden = true;
    this.driving = drives;
  }

  async driveEnded(fence) {
    const round = ++this.round;
    this.drive = null;
    this.root.open = false; // what has just happened is to be seen in the video
    this.show(texts.asking, []);
    const drive = await recordOf({ mac: this.mac, fence, fetchDrives, wait });
    if (round !== this.round) return;
    if (typeof drive === "string") return this.show(texts[drive], []);
    this.drive = drive;
    if (!moved(drive)) return void (this.root.hidden = true);
    this.show(headline(drive), driveRows(drive, this.serverWords));
  }

  show(words, rows) {
    if (this.driving) return;
    this.root.hidden = false;
    setText(part(this.root, "summary-headline"), words);
    part(this.root, "summary-save").hidden = !this.drive;
    const pairs = rows.map(({ name, label, text }) =>
      make("div", {}, make("dt", {}, label), make("dd", { "data-testid": `summary-${name}` }, text)),
    );
    part(this.root, "summary-rows").replaceChildren(...pairs);
  }

  save() {
    const text = `${JSON.stringify(this.drive, null, 2)}\n`;
    download(new Blob([text], { type: "application/json" }), `robotether-${this.robot}-drive-${this.drive.id}.json`);
  }
}

// The record of a drive (docs/reference/protocols.md, /api/v1/drives) in words. Pure.

const metres = (m) => (m >= 1000 ? `${(m / 1000).toFixed(2)} km` : `${m.toFixed(1)} m`);

// As the list of drives has it.
const moved = ({ top_speed_m_s, top_turn_rad_s }) => top_speed_m_s > 0 || top_turn_rad_s > 0;

const duration = ({ started_at, ended_at }) => durationText(Date.parse(ended_at) - Date.parse(started_at));

export const headline = (drive) => texts.headline(duration(drive), metres(drive.distance_m));

// Rows of {name, label, text}; a code without words stays as it is.
export function driveRows(drive, { ends, refusals }) {
  const rows = {
    duration: duration(drive),
    ended: { ...ends, ...endReasons }[drive.end_code] ?? drive.end_code ?? texts.unknown,
    distance: texts.commanded(metres(drive.distance_m)),
    speed: texts.commanded(`${shortNumber(drive.top_speed_m_s)} m/s`),
    latency: latencyText(drive),
    seen: seenText(drive),
    slowed: slowedText(drive),
    pictures: framesText(drive),
    bytes: Number.isFinite(drive.bytes) ? sizeText(drive.bytes) : texts.unknown,
    stops: drive.stops ? String(drive.stops) : texts.nothing,
    refused: refusedText(drive, refusals),
  };
  return Object.entries(rows).map(([name, text]) => ({ name, label: texts.labels[name], text }));
}

function latencyText({ latency_p50_ms, latency_p95_ms }) {
  if (!Number.isFinite(latency_p50_ms)) return texts.unknown;
  return texts.latency(Math.round(latency_p50_ms), Math.round(latency_p95_ms));
}

function seenText({ seen_p50_ms, seen_p95_ms, seen_unknown }) {
  if (!Number.isFinite(seen_p50_ms)) return texts.unknown;
  const known = texts.seen(Math.round(seen_p50_ms), Math.round(seen_p95_ms));
  return seen_unknown ? `${known}; ${texts.seenUnknown(seen_unknown)}` : known;
}

function slowedText({ slowed_s }) {
  if (!Number.isFinite(slowed_s)) return texts.unknown;
  return slowed_s ? texts.slowed(durationText(slowed_s * 1000)) : texts.nothing;
}

function framesText({ frames, frame_bytes, viewed_s }) {
  if (!Number.isFinite(frames)) return texts.unknown;
  if (!frames || !viewed_s) return texts.noVideo;
  return texts.frames(shortNumber(frames / viewed_s), sizeText(frame_bytes ?? 0));
}

function refusedText({ refused = {}, dropped_old }, refusals) {
  const words = Object.entries(refused).map(([kind, count]) => texts.refusals(count, refusals[kind] ?? kind));
  if (dropped_old) words.push(texts.refusals(dropped_old, texts.droppedOld));
  return words.length ? words.join(", ") : texts.nothing;
}

// Gets the record of a drive that has just ended. The server writes it a little later, so it is asked for several times.
const TRIES_MS = [300, 700, 1000, 2000, 3000, 3000]; // 10 s in all

// `fetchDrives(mac, fence)` gives {ok, body} as of calls.js. Gives the record, "missing" or "failed".
export async function recordOf({ mac, fence, fetchDrives, wait }) {
  let answered = false;
  for (const ms of TRIES_MS) {
    await wait(ms);
    const { ok, body } = await fetchDrives(mac, fence);
    answered ||= ok;
    const drive = ok && body.drives?.find((record) => record.fence === fence && record.ended_at);
    if (drive) return drive;
  }
  return answered ? "missing" : "failed";
}
