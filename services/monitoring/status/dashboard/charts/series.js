// Values of numeric fields over time: the past from the unit, then what is added, over a connection of its own.
import { signal } from "@preact/signals";
import { paused, socketAddress } from "../store.js";

const RETRY_S = 2;

// What was received of the fields that are looked at: stamps in seconds, and a column each.
export const series = signal({ time: [], columns: {}, fields: {}, period: 1, refused: null, loaded: false });

let socket = null;
let retry = null;
let held = null; // newest data while the display is paused

function take(frame, seconds) {
  const before = held ?? series.value;
  if (frame.kind === "refused") {
    series.value = { ...before, refused: frame.reason, loaded: true };
    return;
  }
  if (frame.kind === "part") { // further fields of the same past
    held = { ...before, columns: { ...before.columns, ...frame.values }, fields: { ...before.fields, ...frame.fields } };
    if (!paused.value) series.value = held;
    return;
  }
  const more = frame.kind === "more" && before.loaded;
  const time = [...(more ? before.time : []), ...frame.time_ns.map((ns) => ns / 1e9)];
  const surplus = Math.max(0, time.length - Math.ceil(seconds / frame.period_s) - 1);
  const columns = Object.fromEntries(Object.entries(frame.values).map(([name, values]) =>
    [name, [...(more ? before.columns[name] ?? [] : []), ...values].slice(surplus)]));
  held = { time: time.slice(surplus), columns, fields: more ? { ...before.fields, ...frame.fields } : frame.fields, period: frame.period_s, refused: null, loaded: true };
  if (!paused.value) series.value = held;
}

export function resumeSeries() {
  if (held) series.value = held;
}

// Follows these fields until the returned function is called.
export function follow(fields, seconds) {
  let ended = false;
  held = null;
  series.value = { ...series.value, loaded: false, refused: null };
  const open = () => {
    const opened = new WebSocket(socketAddress(`ws/series?seconds=${seconds}&fields=${encodeURIComponent(fields.join())}`));
    socket = opened;
    opened.onmessage = (event) => !ended && take(JSON.parse(event.data), seconds);
    opened.onclose = () => {
      if (ended || series.value.refused) return;
      retry = setTimeout(open, 1000 * RETRY_S);
    };
  };
  if (fields.length > 0) open();
  return () => {
    ended = true;
    clearTimeout(retry);
    socket?.close();
  };
}
