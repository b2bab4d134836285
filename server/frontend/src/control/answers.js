// What a service's answer, or its refusal, means to a person. Pure.

const LONGEST = 300;

// `ok`, `values` as of connection.js's call. std_srvs says in `success` whether it was done.
export const succeeded = ({ ok, values }) => ok && values?.success !== false;

// The answer's own message, or else what it holds beside `success`.
export function answerWords({ values }) {
  if (typeof values === "string") return shortened(values);
  const { success, message, ...more } = values ?? {};
  if (typeof message === "string") return shortened(message);
  if (success !== undefined && Object.keys(more).length === 0) return "";
  return Object.keys(more).length ? shortened(JSON.stringify(more)) : "";
}

export const refusalWords = (why) => shortened(String(why ?? ""));

const shortened = (text) => (text.length > LONGEST ? `${text.slice(0, LONGEST)}…` : text);
