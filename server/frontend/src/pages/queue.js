// The operator's queue: whether this person is available, what is offered, what this person works on, what waits.
// Loaded by queue.html. Each second it asks PUT /api/v1/queue/me, which is also how the server knows that the page is there.

import { api, LoginUse } from "../dom/calls.js";
import { KeyedRows, madeBy } from "../dom/keyedRows.js";
import { Choices, LocalStore, byTestId, localTimestamp, noteScript, part, reloadOnReturn, setText } from "../dom/page.js";
import { askOnce, isNew, markNew, Presses } from "../dom/presses.js";
import { ScreenLock } from "../dom/screenLock.js";
import { ReloadStore } from "../control/driveMode.js";
import { Alerts } from "../queue/alerts.js";
import { Availability } from "../queue/availability.js";
import { Poller, startTicking } from "../queue/poller.js";
import { fillRequest, keyOfRequest, reasonText, secondsText, showDataState, stateText } from "../queue/requestRows.js";
import { queue as texts } from "../texts/queue.js";

const main = /** @type {HTMLElement} */ (document.querySelector("main"));
const [offerPanel, currentPanel] = [part(main, "offer"), part(main, "current")];
const [accept, decline] = [byTestId(main, "offer-accept"), byTestId(main, "offer-decline")];
const feedState = byTestId(main, "queue-feed");
const availability = new Availability();
const screenLock = new ScreenLock();
const notes = new Choices("queue.note", new LocalStore(() => globalThis.sessionStorage)); // the drive page comes between
const alerts = new Alerts({ onChange: showAlerts });
const waiting = new KeyedRows({
  container: part(main, "waiting"),
  keyOf: keyOfRequest,
  make: madeBy("waiting-row"),
  fill: fillRequest,
});
const poller = new Poller({ ask: sendHeartbeat, onAnswer: (view) => show(view), onState: showState });
/** @type {any} */
let view = null; // of the newest answer
let sent = {}; // with the newest heartbeat
/** @type {any} */
let offer = null; // that the panel shows
let answered = ""; // the key of the offer that this person has answered, or is answering

function sendHeartbeat() {
  sent = availability.body;
  return api.put("/api/v1/queue/me", sent);
}

function tick() {
  alerts.tick();
  // One who is away misses nothing that nobody sees.
  if (!document.hidden || availability.state !== "away" || availability.choice) poller.tick();
  if (!poller.isLive) showOfferLeft(null);
}

function show(newest) {
  view = newest;
  availability.receive(view, sent);
  showAvailability();
  showOffer(view.offer);
  showOfferLeft(view.offer_left_s);
  showCurrent(view.current);
  showWaiting(view);
}

function showState(state) {
  showDataState(main, feedState, state);
  showAvailability();
}

// What was known before the answers ended is not said any more.
function showAvailability() {
  const state = poller.isLive ? availability.state : "";
  main.dataset.state = state;
  setText(byTestId(main, "queue-state"), stateText(state, view));
  setText(byTestId(main, "wrap-up-left"), state === "wrap_up" ? secondsText(texts.wrapUpLeft, view?.wrap_up_left_s) : "");
  screenLock.keep(availability.isAvailable);
  press("available", state !== "" && availability.isAvailable);
  press("away", state !== "" && !availability.isAvailable);
  showLapse();
}

const press = (choice, pressed) => byTestId(main, `be-${choice}`).setAttribute("aria-pressed", String(pressed));

function showLapse() {
  const { lapse } = availability;
  const times = lapse && { from: localTimestamp(lapse.from), to: localTimestamp(lapse.to) };
  setText(byTestId(main, "queue-lapse"), times ? texts.lapses[lapse.why](times) : "");
}

function choose(state) {
  availability.choose(state);
  poller.askNow();
}

// The same request may be offered to one person again.
const keyOf = ({ id, offer_until: until }) => `${id} ${until}`;

function showOffer(newest) {
  if (newest && keyOf(newest) === answered) return;
  if (newest && offer && keyOf(newest) === keyOf(offer)) return fillRequest(offerPanel, newest);
  if (offer) setText(byTestId(main, "offer-outcome"), texts.passed(offer.robot));
  if (newest) beginOffer(newest);
  else endOffer();
}

// An offer that takes the place of another takes no press that was meant for that one.
function beginOffer(newest) {
  offer = newest;
  setText(byTestId(main, "offer-outcome"), "");
  setText(part(offerPanel, "offer-alert"), texts.offered(newest.robot, reasonText(newest)));
  fillRequest(offerPanel, newest);
  for (const button of [accept, decline]) markNew(button);
  alerts.offer(texts.titleOffer(newest.robot));
  offerPanel.dataset.offered = "true";
  part(offerPanel, "offer-body").hidden = false;
}

function endOffer() {
  const hadFocus = part(offerPanel, "offer-body").contains(document.activeElement);
  offer = null;
  setText(part(offerPanel, "offer-alert"), "");
  alerts.offer("");
  offerPanel.dataset.offered = "false";
  part(offerPanel, "offer-body").hidden = true;
  if (hadFocus) offerPanel.focus({ preventScroll: true });
}

function showOfferLeft(seconds) {
  const none = (poller.isLive && texts.noOffers[availability.state]) || texts.unknown;
  setText(part(offerPanel, "no-offer"), offer ? "" : none);
  setText(byTestId(main, "offer-left"), offer ? secondsText(texts.offerLeft, seconds) : "");
}

async function answerOffer(button, action, done) {
  if (!offer || isNew(button) || keyOf(offer) === answered) return;
  const chosen = offer;
  answered = keyOf(chosen);
  const outcome = byTestId(main, "offer-outcome");
  const { ok, detail } = await api.post(`/api/v1/requests/${chosen.id}/${action}`);
  if (!ok) {
    answered = "";
    return setText(outcome, texts.refused(detail));
  }
  endOffer();
  setText(outcome, done(chosen.robot));
  if (action === "accept") drive(chosen);
  else poller.askNow();
}

// As Drive on the fleet page: the next page of this tab takes the control, if it is free.
function drive({ robot, mac }) {
  new ReloadStore(mac).save({ armed: true, asked: true });
  location.assign(`/robots/${encodeURIComponent(robot)}`);
}

// Another request takes neither the note nor a press that was meant for the one before.
function showCurrent(request) {
  currentPanel.hidden = !request;
  if (!request) return;
  const id = String(request.id);
  if (currentPanel.dataset.request !== id) {
    byTestId(main, "close-note").value = notes.all.id === id ? notes.all.note : "";
    for (const button of currentPanel.querySelectorAll("button")) markNew(button);
  }
  currentPanel.dataset.request = id;
  fillRequest(currentPanel, request);
}

async function close(event) {
  event.preventDefault();
  const { current } = view ?? {};
  if (!current || isNew(byTestId(main, "close-request"))) return;
  const note = byTestId(main, "close-note");
  const answer = await askOnce(current.id, () => api.post(`/api/v1/requests/${current.id}/close`, { note: note.value.trim() }));
  if (!answer) return;
  setText(byTestId(main, "close-outcome"), answer.ok ? texts.closed(current.robot) : texts.refused(answer.detail));
  if (!answer.ok) return;
  note.value = "";
  notes.keep({ note: "" });
  part(main, "state-line").focus(); // the panel with the focus goes
  poller.askNow();
}

function showWaiting({ waiting: listed, waiting_count: count }) {
  waiting.show(listed);
  setText(part(main, "waiting-more"), count > listed.length ? texts.more(count - listed.length) : "");
  setText(part(main, "waiting-none"), listed.length ? "" : texts.waitingNone);
}

function showAlerts() {
  for (const name of ["sound", "title"]) byTestId(main, `alert-${name}`).checked = alerts.isOn(name);
  setText(byTestId(main, "sound-note"), alerts.isSilenced ? texts.silentSound : "");
}

for (const state of ["available", "away"]) byTestId(main, `be-${state}`).addEventListener("click", () => choose(state));
for (const name of ["sound", "title"]) {
  byTestId(main, `alert-${name}`).addEventListener("change", ({ target }) => alerts.set(name, target.checked));
}
accept.addEventListener("click", () => answerOffer(accept, "accept", texts.accepting));
decline.addEventListener("click", () => answerOffer(decline, "decline", texts.declined));
byTestId(main, "current-drive").addEventListener("click", () => view?.current && drive(view.current));
part(main, "close").addEventListener("submit", close);
byTestId(main, "close-note").addEventListener("input", ({ target }) =>
  notes.keep({ id: currentPanel.dataset.request, note: target.value }),
);
for (const name of ["pointerdown", "keydown"]) window.addEventListener(name, () => alerts.isSilenced && alerts.unlock());
document.addEventListener("visibilitychange", tick);
reloadOnReturn();
new Presses().watch(window);
new LoginUse().watch(window);
showAlerts();
startTicking(tick, main.dataset.ticker);
noteScript();
tick();
