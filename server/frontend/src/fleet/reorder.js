// Which of a list's items have to move so that it gets into another order: as few as can be. Pure.

// `present` and `wanted` are names, each once. Those of `wanted` that are not present are among them.
export function itemsToMove(present, wanted) {
  const place = new Map(present.map((name, i) => [name, i]));
  const places = wanted.map((name) => place.get(name) ?? -1);
  const staying = longestRise(places);
  return new Set(wanted.filter((_, i) => !staying.has(i)));
}

// The indices of the longest rising subsequence of what is not negative.
function longestRise(values) {
  const ends = []; // index of the least end of a rise of each length
  const before = new Array(values.length).fill(-1);
  values.forEach((value, i) => {
    if (value < 0) return;
    const length = firstNotBelow(ends, values, value);
    before[i] = length > 0 ? ends[length - 1] : -1;
    ends[length] = i;
  });
  const rise = new Set();
  for (let i = ends.at(-1) ?? -1; i >= 0; i = before[i]) rise.add(i);
  return rise;
}

function firstNotBelow(ends, values, value) {
  let [low, high] = [0, ends.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (values[ends[middle]] < value) low = middle + 1;
    else high = middle;
  }
  return low;
}
