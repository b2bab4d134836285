// The ends of grants: shown and typed in the reader's own time, sent in UTC, as the page has them without this script.

import { api, serverClock } from "../dom/calls.js";
import { make } from "../dom/page.js";

const MINUTE_MS = 60_000;

// A time of a field, without its zone, from UTC to the reader's, and back as RFC 3339. Empty stays empty.
function localTimeOf(text) {
  if (!text) return "";
  const time = new Date(`${text}Z`);
  return new Date(time.getTime() - time.getTimezoneOffset() * MINUTE_MS).toISOString().slice(0, text.length);
}

const utcTimeOf = (text) => (text ? new Date(text).toISOString() : "");

function showLocalTimes(table) {
  for (const zone of table.querySelectorAll("[data-part=zone]")) zone.textContent = "local time";
  for (const field of table.querySelectorAll("input[type=datetime-local]")) showLocalTime(field);
  // From here on an end that nobody changed needs no button that saves it.
  table.dataset.zone = "local";
}

function showLocalTime(field) {
  field.defaultValue = localTimeOf(field.defaultValue);
  const isChanged = () => field.value !== field.defaultValue;
  field.addEventListener("input", () => field.classList.toggle("changed", isChanged()));
  // The field has minutes; an end that nobody changed keeps its seconds.
  field.form.addEventListener("formdata", ({ formData }) => {
    formData.set("ends_at", isChanged() ? utcTimeOf(field.value) : (field.dataset.endsAt ?? utcTimeOf(field.value)));
  });
}

const HOUR_MS = 60 * MINUTE_MS;

// The ends that are usual, as a field of the reader's own time has them.
/** @type {[string, (now: Date) => string][]} */
export const USUAL_ENDS = [
  ["1 h", (now) => fieldText(new Date(now.getTime() + HOUR_MS))],
  ["Today", (now) => `${fieldText(now).slice(0, 10)}T23:59`],
  ["7 days", (now) => fieldText(new Date(now.getFullYear(), now.getMonth(), now.getDate() + 7, now.getHours(), now.getMinutes()))],
  ["No end", () => ""],
];

const fieldText = (time) => localTimeOf(time.toISOString().slice(0, "2026-01-01T12:03".length));

function offerUsualEnds(field) {
  const buttons = USUAL_ENDS.map(([words, end]) => {
    const button = make("button", { type: "button", class: "small" }, words);
    // A press must not take the focus: the buttons of a row show as long as its field has it.
    button.addEventListener("pointerdown", (event) => event.preventDefault());
    button.addEventListener("click", () => {
      field.value = end(new Date(serverClock.nowMs));
      field.dispatchEvent(new Event("input"));
    });
    return button;
  });
  (field.closest(".end") ?? field).after(make("div", { class: "ends", role: "group", "aria-label": "Usual ends" }, ...buttons));
}

if (typeof document !== "undefined") {
  api.get("/api/v1/me"); // for the time of its answer: this machine's clock may be wrong
  for (const table of document.querySelectorAll("table.grants")) showLocalTimes(table);
  for (const field of document.querySelectorAll("table.grants input[type=datetime-local]")) offerUsualEnds(field);
}
