// What pages of lists and forms need of a script: buttons that copy, times and days of the reader's own zone, and Drive.

import { offerDrive } from "../fleet/cards.js";
import { inWindow, WINDOW } from "../fleet/filters.js";
import { api } from "../dom/calls.js";
import { foldFilters, hasWords, make, reloadOnReturn, setText, showLocalTimes } from "../dom/page.js";
import { Presses, markOpened, sendOnce } from "../dom/presses.js";
import { fleet as texts } from "../texts/fleet.js";
import { Uplink } from "../topics/uplink.js";
import { Ticks } from "./ticks.js";

const SHOWN_MS = 2000;
const DAY_LENGTH = 10;
const RENEW_MS = 60_000; // "today" ends while a page is open

// data-copy is the id of the text's element. The buttons show only where copying works.
function wireCopyButtons(page, clipboard) {
  if (!clipboard) return;
  for (const button of page.querySelectorAll("[data-copy]")) {
    const words = button.textContent;
    button.hidden = false;
    button.addEventListener("click", async () => {
      button.textContent = await copied(clipboard, page.getElementById(button.dataset.copy).textContent);
      setTimeout(() => {
        button.textContent = words;
      }, SHOWN_MS);
    });
  }
}

async function copied(clipboard, text) {
  try {
    await clipboard.writeText(text);
    return "Copied";
  } catch {
    return "Select and copy by hand";
  }
}

// Gives the time, in RFC 3339, when a day of the reader's zone begins or, for the end of a filter, that it is over.
function startOrEnd(day, isEnd) {
  const [year, month, date] = day.split("-").map(Number);
  return new Date(year, month - 1, date + (isEnd ? 1 : 0)).toISOString().replace(".000", "");
}

// Gives the reader's day of a filter's text: a day in UTC, or a time as startOrEnd gives it.
function dayOf(text, isEnd) {
  if (text.length <= DAY_LENGTH) return text;
  const time = new Date(new Date(text).getTime() - (isEnd ? 1 : 0));
  const padded = (number) => String(number).padStart(2, "0");
  return `${time.getFullYear()}-${padded(time.getMonth() + 1)}-${padded(time.getDate())}`;
}

// The days of a filter are the reader's, and its query has the times; without this script they are in UTC.
export function wireDays(form) {
  const days = [...form.querySelectorAll("[data-day]")];
  for (const field of days) field.value = dayOf(field.dataset.at, field.name === "until");
  for (const words of form.querySelectorAll('[data-part="zone"]')) words.remove();
  form.addEventListener("formdata", ({ formData }) => {
    for (const { name, value } of days) if (value) formData.set(name, startOrEnd(value, name === "until"));
  });
}

// Whether the address has a filter, and not only a page of the list or what is ticked in it.
const isFiltered = (form, query) => [...form.elements].some(({ name }) => name && query.get(name));

const MANY_OPTIONS = 12;

// A choice among many gets a field that leaves those with the typed words, and what is chosen.
function offerSearch(select, field) {
  const options = [...select.options].map((option) => ({ option, parent: option.parentElement }));
  if (options.length <= MANY_OPTIONS) return false;
  field.addEventListener("input", () => {
    for (const { option } of options) option.remove();
    for (const { option, parent } of options) {
      if (option.selected || hasWords(option.textContent, field.value)) parent.append(option);
    }
  });
  return true;
}

function searchField(what) {
  const label = `Search ${what}`.trim();
  return make("input", { type: "search", "aria-label": label, placeholder: "Search", autocapitalize: "none", spellcheck: "false" });
}

function wireSearch(select) {
  const field = searchField(select.labels[0]?.textContent ?? "");
  if (offerSearch(select, field)) select.before(field);
}

// A long list shows WINDOW of the rows that have the typed words, and a press shows more. A row with a wrong field always shows.
function offerWindow(rows, field, more) {
  if (rows.length <= WINDOW) return false;
  let length = WINDOW;
  const show = () => {
    const { shown, left } = inWindow(rows, (row) => hasWords(row.textContent, field.value), length);
    for (const row of rows) row.hidden = !shown.has(row) && !row.querySelector(".wrong, [aria-invalid]");
    more.hidden = left === 0;
    setText(more, texts.more(Math.min(WINDOW, left), left));
  };
  field.addEventListener("input", show);
  more.addEventListener("click", () => {
    length += WINDOW;
    show();
  });
  show();
  return true;
}

function wireList(table) {
  const field = searchField("this list");
  const more = make("button", { type: "button" });
  if (!offerWindow([...table.tBodies[0].rows], field, more)) return;
  const list = table.closest(".listing") ?? table;
  list.before(make("div", { class: "field" }, field));
  list.after(make("p", { class: "actions" }, more));
}

// Drive on the pages of one robot.
function wireDrive(page) {
  for (const robot of page.querySelectorAll("[data-mac]")) offerDrive(robot, robot.dataset.mac);
}

// What fills the uplink, on the page of one robot.
function wireUplink(page) {
  for (const panel of page.querySelectorAll('[data-part="uplink"]')) {
    new Uplink(panel, { get: () => api.uplink(panel.dataset.of, panel.dataset.mac) }).renew();
  }
}

if (typeof document !== "undefined") {
  new Presses().watch(window);
  reloadOnReturn();
  document.querySelectorAll("[data-settles]").forEach(markOpened);
  sendOnce(document);
  wireCopyButtons(document, navigator.clipboard);
  showLocalTimes(document);
  setInterval(() => showLocalTimes(document), RENEW_MS);
  wireDrive(document);
  wireUplink(document);
  for (const bar of document.querySelectorAll('[data-part="ticks"]')) new Ticks(document, bar, window).wire();
  for (const select of document.querySelectorAll("select")) wireSearch(select);
  for (const table of document.querySelectorAll("table.list")) wireList(table);
  for (const form of document.querySelectorAll("form.filter")) {
    wireDays(form);
    foldFilters(form, isFiltered(form, new URLSearchParams(location.search)));
  }
}
