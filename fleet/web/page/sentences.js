// What happened, in sentences: events of vehicles, charges, details of alarms and of the audit. Content is anybody's: each
// value is taken as text, and what has not the form of its topic is shown by names and values without brackets.
import { languageOf } from "./unit/parts.js";
import { words } from "./unit/words.js";

const DEPTH = 3; // of values in values
const MOST = 1000; // characters of a sentence

const isText = (value) => ["string", "number", "boolean"].includes(typeof value);
const text = (value) => (isText(value) ? String(value).trim() : "");
const list = (value) => (Array.isArray(value) ? value : []);
const ended = (sentence) => (/[.!?]$/.test(sentence) ? sentence : `${sentence}.`);
const verdict = (value) => words.trust[text(value)] ?? text(value);
const named = (key) => key.replaceAll("_", " ");

function flat(value, depth = 0) {
  if (value == null) return "none";
  if (isText(value)) return text(value);
  if (depth >= DEPTH) return "...";
  if (Array.isArray(value)) return value.map((one) => flat(one, depth + 1)).filter(Boolean).join("; ");
  return Object.entries(value).map(([key, one]) => `${named(key)} ${flat(one, depth + 1)}`).join(", ");
}

// Names and values without brackets.
export const plain = (content) => Object.entries(content ?? {}).map(([key, value]) => `${named(key)}: ${flat(value)}`).join(", ").slice(0, MOST);

const accused = (monitor) => [text(monitor?.monitor), text(monitor?.reason)].filter(Boolean).join(": ");

// By topic; null where content has not its form.
const SENTENCES = {
  "trust/event": ({ before, after, reasons, monitors }) => {
    if (!text(after)) return null;
    const because = list(reasons).map(text).filter(Boolean);
    const against = list(monitors).map(accused).filter(Boolean);
    return [`The verdict became ${verdict(after)}${text(before) ? `, before ${verdict(before)}` : ""}.`, ...because.map(ended), ...against.map((one) => `Accusing: ${ended(one)}`)].join(" ");
  },
  "outage/event": ({ what, cause, until_ns: until, since_ns: since, affected }) => {
    if (!text(what)) return null;
    const seconds = typeof until === "number" && typeof since === "number" ? Math.max(0, (until - since) / 1e9) : null;
    const silent = list(affected).map(text).filter(Boolean);
    return [seconds === null ? `An outage of ${text(what)} began.` : `An outage of ${text(what)} ended after ${seconds.toFixed(0)} s.`,
      text(cause) && ended(text(cause)), silent.length > 0 && `Silent: ${silent.join(", ")}.`].filter(Boolean).join(" ");
  },
  "toll/transaction": ({ kind, plaza, lane, amount_cents: cents, currency, contract, tariff_class: tariff, authenticated, confirmed, reason }) => {
    if (!text(plaza) || typeof cents !== "number") return null;
    const amount = `${(Math.abs(cents) / 100).toFixed(2)} ${text(currency)}`.trim();
    const what = text(kind) === "reversal" ? `A charge of ${amount} was reversed` : `${amount} was charged`;
    return [`${what} at ${text(plaza)}${text(lane) && `, lane ${text(lane)}`}${text(tariff) && `, class ${text(tariff)}`}${text(contract) && `, contract ${text(contract)}`}.`,
      authenticated === false && "The passage was not authenticated.", confirmed === false && "No detector confirmed it.", text(reason) && ended(text(reason))].filter(Boolean).join(" ");
  },
  "origin/state": ({ kind, name }) => (text(kind) ? `The data are ${text(kind) === "live" ? "live" : text(kind) === "replay" ? "a replay" : text(kind)}${text(name) && ` (${text(name)})`}.` : null),
  "uplink/gap": ({ why, bytes, reason }) => {
    if (text(why) === "full") return `The outbox was full${typeof bytes === "number" ? ` at ${Math.round(bytes / 1e6)} MB` : ""}: its oldest positions were dropped.`;
    return text(why) === "damaged" ? ["The outbox was damaged, and another one was begun.", text(reason) && ended(text(reason))].filter(Boolean).join(" ") : null;
  },
  "uplink/clock": ({ before_ms: before, after_ms: after, source }) => {
    if (typeof before !== "number" || typeof after !== "number") return null;
    return `The clock of the unit was set ${after >= before ? "forward" : "back"} by ${(Math.abs(after - before) / 1000).toFixed(1)} s${text(source) && `, by ${text(source)}`}.`;
  },
};

// Names of events, as an operator knows them.
const NAMES = {
  "trust/event": "Verdict", "outage/event": "Outage", "toll/transaction": "Charge", "origin/state": "Data", "uplink/gap": "Outbox", "uplink/clock": "Clock",
};
export const nameOf = (topic) => NAMES[topic] ?? topic;

// Of an event, whose texts the centre has put into words by their codes.
export function sentenceOf(topic, { content, ...row }) {
  const known = content && typeof content === "object" && !Array.isArray(content) ? { ...content, ...row.languages?.[languageOf(row)] } : {};
  if (isText(known.left_out)) return `Its content is left out: ${ended(text(known.left_out))}`;
  return (Object.hasOwn(SENTENCES, topic) ? SENTENCES[topic](known) : null)?.slice(0, MOST) ?? plain(known);
}

// The detail of an alarm: by its code in the browser's language, else by names and values.
export const alarmSentence = (row, detail) => row.languages?.[languageOf(row)]?.sentence ?? plain(detail);
