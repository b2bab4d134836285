// Requests for help as rows of a page, whose markup is the server's. All that people and robots wrote is text, never markup.

import { durationText, localTimestamp, part, setText } from "../dom/page.js";
import { data as dataTexts, queue as queueTexts, requests as texts } from "../texts/queue.js";

export const keyOfRequest = ({ id }) => String(id);

// What is written of a request, by the part that it goes into. Pure. Unknown is "-".
export function requestFacts({ robot, reason, source, priority, pool, asked_by: asker, age_s: age, state, ...more }) {
  return {
    robot,
    reason: reasonText({ reason, source }),
    priority: texts.priorities[priority] ?? texts.unknown,
    pool: pool || texts.anyPool,
    asker: asker || texts.unknown,
    age: ageText(age),
    state: texts.states[state]?.(more) ?? texts.unknown,
  };
}

// How it is ended: what nobody has accepted is cancelled, for it was not answered. Pure.
export const endOf = ({ state }) => (state === "accepted" ? "close" : "cancel");

// A rule of the robot names itself; what else asks has words of its own.
export const reasonText = ({ reason, source }) => reason || texts.sources[source] || texts.noReason;

export const ageText = (seconds) => (Number.isFinite(seconds) ? durationText(seconds * 1000) : texts.unknown);

// Writes the facts into those parts that the element has.
export function fillRequest(element, request) {
  for (const [name, words] of Object.entries(requestFacts(request))) setText(part(element, name), words);
  element.dataset.priority = String(request.priority);
  element.dataset.state = request.state;
  const link = part(element, "robot");
  if (link?.tagName === "A") link.setAttribute("href", `/robots/${encodeURIComponent(request.robot)}`);
}

// Where this person stands, by the newest QueueView; "" is unknown. Pure.
export const stateText = (state, view) =>
  queueTexts.states[state]?.({ ahead: view?.ahead, robot: view?.current?.robot }) ?? queueTexts.stateUnknown;

// Seconds that are left, as `written` has them.
export const secondsText = (written, seconds) => (Number.isFinite(seconds) ? written(Math.ceil(seconds)) : texts.unknown);

// Says on its line how old what a page shows is; `state` as of Poller.
export function showDataState(main, line, state) {
  line.dataset.feed = state.name;
  main.dataset.stale = String(state.name !== "live");
  setText(line, dataTexts[state.name]({ ...state, since: state.since && localTimestamp(state.since) }));
}
