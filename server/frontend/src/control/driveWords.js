// The record of a drive (docs/protocols.md, /api/v1/drives) in words. Pure.

import { endings, refusals, summary as texts } from "../texts/panels.js";
import { shortNumber, sizeText } from "../topics/samples.js";

// "2 h 3 min", "2 min 5 s", "5 s".
export function durationText(ms) {
  const seconds = Math.max(0, Math.round(ms / 1000));
  const [hours, minutes] = [Math.floor(seconds / 3600), Math.floor((seconds % 3600) / 60)];
  if (hours) return `${hours} h ${minutes} min`;
  return minutes ? `${minutes} min ${seconds % 60} s` : `${seconds} s`;
}

const metres = (m) => (m >= 1000 ? `${(m / 1000).toFixed(2)} km` : `${m.toFixed(1)} m`);

// As the list of drives has it.
export const moved = ({ top_speed_m_s, top_turn_rad_s }) => top_speed_m_s > 0 || top_turn_rad_s > 0;

const duration = ({ started_at, ended_at }) => durationText(Date.parse(ended_at) - Date.parse(started_at));

export const headline = (drive) => texts.headline(duration(drive), metres(drive.distance_m));

// Rows of {name, label, text}.
export function driveRows(drive) {
  const rows = {
    duration: duration(drive),
    ended: endings[drive.end_code] ?? drive.end_code ?? texts.unknown,
    distance: texts.commanded(metres(drive.distance_m)),
    speed: texts.commanded(`${shortNumber(drive.top_speed_m_s)} m/s`),
    latency: latencyText(drive),
    pictures: picturesText(drive),
    bytes: Number.isFinite(drive.bytes) ? sizeText(drive.bytes) : texts.unknown,
    stops: drive.stops ? String(drive.stops) : texts.nothing,
    refused: refusedText(drive),
  };
  return Object.entries(rows).map(([name, text]) => ({ name, label: texts.labels[name], text }));
}

function latencyText({ latency_p50_ms, latency_p95_ms }) {
  if (!Number.isFinite(latency_p50_ms)) return texts.unknown;
  return texts.latency(Math.round(latency_p50_ms), Math.round(latency_p95_ms));
}

function picturesText({ pictures, picture_bytes, viewed_s }) {
  if (!pictures || !viewed_s) return texts.noPictures;
  return texts.pictures(shortNumber(pictures / viewed_s), sizeText(picture_bytes ?? 0));
}

function refusedText({ refused = {}, dropped_old }) {
  const all = { ...refused, ...(dropped_old ? { dropped_old } : {}) };
  const words = Object.entries(all).map(([kind, count]) => texts.refusals(count, refusals[kind] ?? kind));
  return words.length ? words.join(", ") : texts.nothing;
}
