// Shows one probe of a topic: its newest message, how often it comes, and one of its numbers over the last minute.

import { make, makeButton, setText, shortNumber, sizeText } from "../dom/page.js";
import { topics as texts } from "../texts/panels.js";
import { preview } from "./fields.js";
import { TopicProbe, MEASURE_MS } from "./topicProbe.js";

const TICK_MS = 500;

export class Inspector {
  // `onClose()` when the person closes it.
  constructor({ topic, watch, onClose }) {
    this.topic = topic;
    this.build(topic, onClose);
    this.probe = new TopicProbe({ topic, watch, onChange: () => (this.changed = true) });
    this.timer = setInterval(() => this.show(), TICK_MS);
    this.show();
  }

  build({ name, type }, onClose) {
    const close = makeButton("topic-close", "×", onClose, { "aria-label": texts.close(name) });
    this.pace = make("span", { "data-testid": "topic-rate" });
    const help = texts.measureHelp(MEASURE_MS / 1000);
    this.measure = makeButton("topic-measure", texts.measure, () => this.probe.measure(), { title: help });
    this.large = make("p", { class: "hint" }, texts.large);
    this.getOne = makeButton("topic-get-one", texts.getOne, () => this.probe.getOne());
    this.notice = make("p", { class: "topic-notice", role: "status", "data-testid": "topic-notice" });
    this.content = make("pre", { tabindex: "0", role: "region", "aria-label": texts.content(name), "data-testid": "topic-content" });
    // All digits while somebody points at it or reads it by the keyboard.
    for (const name of ["pointerenter", "pointerleave", "focus", "blur"]) this.content.addEventListener(name, () => this.showMessage());
    this.element = make(
      "section",
      { class: "topic-look", "aria-label": name, "data-testid": "topic-look", "data-topic": name },
      make("header", {}, make("h2", {}, name), close),
      make("p", { class: "topic-type" }, type || texts.untyped),
      make("div", { class: "topic-pace" }, this.pace, this.measure),
      this.large,
      this.getOne,
      this.notice,
      this.content,
      this.buildPlot(),
    );
  }

  buildPlot() {
    this.field = make("select", { "data-testid": "topic-field" }, new Option(texts.noField, ""));
    this.field.addEventListener("change", () => this.choose());
    this.canvas = make("canvas", { role: "img", "data-testid": "topic-plot" });
    this.canvas.hidden = true;
    this.words = make("p", { class: "hint", "data-testid": "topic-plot-words" });
    const label = make("label", {}, make("span", {}, texts.field), " ", this.field);
    this.chosen = make("div", { class: "topic-field" }, label, this.canvas, this.words);
    return this.chosen;
  }

  choose() {
    const field = this.field.value;
    this.probe.plot(field);
    this.canvas.hidden = !field;
    this.canvas.setAttribute("aria-label", field ? texts.plot(field) : "");
    this.show();
  }

  show() {
    const { probe } = this;
    setText(this.pace, [paceText(probe.pace), probe.size ? texts.size(sizeText(probe.size)) : ""].filter(Boolean).join(", "));
    this.measure.setAttribute("aria-disabled", String(Boolean(probe.measuring)));
    setText(this.notice, noticeText(probe));
    this.getOne.hidden = this.large.hidden = !probe.large;
    this.chosen.hidden = this.measure.hidden = probe.large;
    if (this.changed && !this.isBeingRead()) {
      this.changed = false;
      this.showMessage();
      this.offerFields();
    }
    this.showPlot();
  }

  showMessage() {
    const { message } = this.probe;
    if (this.isBeingRead()) return;
    setText(this.content, message === null ? "" : preview(message, { exact: this.content.matches(":hover, :focus") }));
  }

  // What is selected, to be copied, stays.
  isBeingRead() {
    const selection = document.getSelection();
    return selection !== null && !selection.isCollapsed && this.content.contains(selection.anchorNode);
  }

  offerFields() {
    const { paths, isCut } = this.probe.numbers;
    const numbers = `${paths} ${isCut}`;
    if (paths.length === 0 || numbers === this.offered) return;
    this.offered = numbers;
    const chosen = this.field.value;
    const all = paths.includes(chosen) || !chosen ? paths : [chosen, ...paths];
    const more = isCut ? [make("option", { disabled: "" }, texts.moreFields)] : [];
    this.field.replaceChildren(new Option(texts.noField, ""), ...all.map((path) => new Option(path, path)), ...more);
    this.field.value = chosen;
  }

  showPlot() {
    const { probe } = this;
    if (!probe.field) return setText(this.words, "");
    const extent = probe.samples.extent(probe.now());
    const { now, min, max } = extent ?? {};
    const words = { now: now === null ? texts.unknownNow : shortNumber(now), min: shortNumber(min), max: shortNumber(max) };
    setText(this.words, extent ? texts.plotted(words) : texts.notPlotted);
    drawPlot(this.canvas, probe.samples.points, extent, probe.now());
  }

  end() {
    clearInterval(this.timer);
    this.probe.end();
    this.element.remove();
  }
}

const PACES = {
  none: () => "",
  measuring: () => texts.measuring,
  measured: ({ perSecond, seconds }) => texts.measured(shortNumber(perSecond), seconds),
  slow: ({ seconds }) => texts.rateSlow(seconds),
  least: ({ perSecond }) => texts.rateAtLeast(shortNumber(perSecond)),
  rate: ({ perSecond }) => texts.rate(shortNumber(perSecond)),
};

const paceText = (pace) => PACES[pace.kind](pace);

function noticeText({ state, refusal, message, unread, large, ends }) {
  if (state === "refused") return texts.refused(refusal);
  if (state === "too_big") return texts.tooBig;
  if (state === "lost") return texts.lost;
  if (unread) return texts.unread(message !== null);
  return message === null && (!large || ends.size > 0) ? texts.waiting : "";
}

// Draws the numbers of the last minute on a canvas, newest at the right.
const MINUTE_MS = 60_000;
const PADDING = 4;

// The points as places on a canvas of this size; what does not change lies in the middle, and a gap has no `y`. Pure.
function places(points, { now, min, max }, { width, height }) {
  const span = max - min;
  const room = height - 2 * PADDING;
  return points.map(({ value, at }) => ({
    x: width * (1 - (now - at) / MINUTE_MS),
    y: value === null ? null : PADDING + room * (span > 0 ? 1 - (value - min) / span : 0.5),
  }));
}

// `extent` as of LastMinute, or null.
function drawPlot(canvas, points, extent, now) {
  const scale = window.devicePixelRatio || 1;
  const size = { width: canvas.clientWidth, height: canvas.clientHeight };
  canvas.width = Math.round(size.width * scale);
  canvas.height = Math.round(size.height * scale);
  const context = canvas.getContext("2d");
  context.scale(scale, scale);
  context.clearRect(0, 0, size.width, size.height);
  if (!extent) return;
  context.strokeStyle = getComputedStyle(canvas).color;
  context.lineWidth = 2;
  context.beginPath();
  drawLine(context, places(points, { ...extent, now }, size));
  context.stroke();
}

// With gaps, which no line crosses.
function drawLine(context, line) {
  line.forEach(({ x, y }, i) => {
    if (y === null) return;
    if ((line[i - 1]?.y ?? null) === null) context.moveTo(x, y);
    context.lineTo(x, y);
  });
}
