// What is wanted of a camera (docs/media.md, `want`), by the person's choice, the robot's settings and the room on the page. Pure.

// Automatic, or one of the steps that the paper drove with, and one below.
const QUALITIES = ["auto", "90", "70", "50", "30"];

// A small picture is asked for in few sizes: each change is a new request at the camera.
const PARTS = [0.25, 0.5];
const ENOUGH = 0.9; // of the pixels that the page has

export function requestedQuality(choice, { quality_min = 20, quality_max = 80 } = {}) {
  if (choice === "auto" || !QUALITIES.includes(choice)) return { quality_min, quality_max };
  return { quality_min: Number(choice), quality_max: Number(choice) };
}

// `full`: the camera's own size as far as it is known, or null. `set`: the settings' {width, height}, or nulls.
// `box`: the place on the page in device pixels. Gives {width, height}, null for the camera's own.
export function requestedSize({ full, set, box, turned }) {
  const whole = set.width ? set : OWN;
  const size = set.width ? set : full;
  const part = size && box.width && box.height ? partOf(size, across(box, turned)) : 1;
  return part === 1 ? whole : { width: even(size.width * part), height: even(size.height * part) };
}

const OWN = { width: null, height: null };

// The box as the camera sees it.
const across = (box, turned) => (turned % 180 ? { width: box.height, height: box.width } : box);

function partOf(size, box) {
  const needed = Math.min(box.width / size.width, box.height / size.height) * ENOUGH;
  return PARTS.find((part) => part >= needed) ?? 1;
}

const even = (pixels) => Math.max(2, Math.round(pixels / 2) * 2);
