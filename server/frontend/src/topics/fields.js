// Looks into a message of any type: the numbers in it, and a text of it that is never long. Pure.

const MAX_NUMBERS = 200;
const MAX_LIST_NUMBERS = 8;
const MAX_DEPTH = 10;
const MAX_LINES = 200;
const MAX_TEXT_LENGTH = 160;
const MAX_PLAIN_ITEMS = 16;
const MAX_OBJECT_ITEMS = 4;
const DIGITS = 4;

// The paths of the numbers (and truths) in a message: "twist.linear.x", "ranges[0]"; `isCut`: there may be more than these.
export function numbersIn(message) {
  const numbers = { paths: /** @type {string[]} */ ([]), isCut: false };
  collect(message, "", 0, numbers);
  return numbers;
}

function collect(value, path, depth, numbers) {
  const { paths } = numbers;
  if (depth > MAX_DEPTH || (isNumber(value) && paths.length >= MAX_NUMBERS)) return void (numbers.isCut = true);
  if (isNumber(value)) paths.push(path || "value");
  numbers.isCut ||= isLongList(value);
  for (const [step, inner] of members(value)) collect(inner, pathTo(path, step), depth + 1, numbers);
}

const isNumber = (value) => ["number", "boolean"].includes(typeof value);

const isLongList = (value) => Array.isArray(value) && value.length > MAX_LIST_NUMBERS;

const pathTo = (path, step) => path + (path && !step.startsWith("[") ? "." : "") + step;

function members(value) {
  if (value === null || typeof value !== "object") return [];
  if (!Array.isArray(value)) return Object.entries(value);
  return value.slice(0, MAX_LIST_NUMBERS).map((item, i) => [`[${i}]`, item]);
}

// The number at such a path; NaN where there is none.
export function numberAt(message, path) {
  const steps = path.match(/[^.[\]]+/g) ?? [];
  let value = message;
  for (const step of steps) value = value?.[step];
  if (typeof value === "boolean") return Number(value);
  return typeof value === "number" ? value : NaN;
}

// A message as lines of "name: value"; what is long is cut, and says how much is left out. Numbers have all their digits if
// `exact`, else those that a person reads.
export function preview(message, { exact = false } = {}) {
  /** @type {string[]} */
  const lines = [];
  write(message, "", { lines, number: exact ? String : readable }, 0);
  return lines.slice(0, MAX_LINES).join("\n") + (lines.length > MAX_LINES ? "\n…" : "");
}

function write(value, indent, out, depth) {
  if (out.lines.length > MAX_LINES) return;
  if (depth > MAX_DEPTH) out.lines.push(`${indent}…`);
  else if (Array.isArray(value)) writeList(value, indent, out, depth);
  else for (const [name, inner] of Object.entries(value ?? {})) writeMember(name, inner, indent, out, depth);
}

function writeMember(name, value, indent, out, depth) {
  const { lines, number } = out;
  if (lines.length > MAX_LINES) return;
  if (isPlain(value)) lines.push(`${indent}${name}: ${plain(value, number)}`);
  else {
    lines.push(`${indent}${name}:`);
    write(value, `${indent}  `, out, depth + 1);
  }
}

function writeList(list, indent, out, depth) {
  const items = list.slice(0, MAX_OBJECT_ITEMS);
  items.forEach((item, i) => writeMember(`[${i}]`, item, indent, out, depth));
  if (list.length > items.length) out.lines.push(`${indent}… ${list.length - items.length} more`);
}

// Whole numbers stay, as they are counters and times; so does the whole part of others.
function readable(number) {
  if (Number.isInteger(number)) return String(number);
  return String(Math.abs(number) >= 10 ** DIGITS ? Math.round(number) : Number(number.toPrecision(DIGITS)));
}

const isPlain = (value) => value === null || typeof value !== "object" || (Array.isArray(value) && value.every(isScalar));

const isScalar = (value) => value === null || typeof value !== "object";

function plain(value, number) {
  if (!Array.isArray(value)) return scalar(value, number);
  const more = value.length > MAX_PLAIN_ITEMS ? `, … ${value.length - MAX_PLAIN_ITEMS} more` : "";
  return `[${value
    .slice(0, MAX_PLAIN_ITEMS)
    .map((item) => scalar(item, number))
    .join(", ")}${more}]`;
}

function scalar(value, number) {
  if (typeof value === "number") return number(value);
  if (typeof value !== "string") return String(value);
  if (value.length <= MAX_TEXT_LENGTH) return value;
  return `${value.slice(0, MAX_TEXT_LENGTH)}… ${value.length - MAX_TEXT_LENGTH} more characters`;
}
