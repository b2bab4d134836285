// The ends of grants: shown and typed in the reader's own time, sent in UTC, as the page has them without this script.

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

for (const table of document.querySelectorAll("table.grants")) showLocalTimes(table);
