// What the pages know of the centre: the link, changes that it tells, and requests.
import { signal } from "@preact/signals";
import { change, clock, session, socketAddress, toLogin } from "./unit/store.js";
import { w } from "./words.js";

const BACKOFF_S = [0.5, 1, 2, 5];
const SILENT_S = 5; // a frame comes at least once a second
const ANSWER_MS = 10000;

export const VERDICTS = ["safe", "caution", "dead_reckoning", "initialising", "no_fix", "unsafe"];
export const OLD_S = 90; // of shared/fleet/times.py
export const link = signal({ open: false, bus: true, lostAt: null });
export const alarmsRaised = signal(0); // counts frames with alarms
const listeners = new Set();

// The newest report of each vehicle that a frame or an answer held, and when it was heard or asked for: what was asked
// for earlier shows the same, so that no two places of a page state two verdicts of one vehicle.
const REMEMBERED = 20000;
const newest = new Map();
export const heard = signal(0); // counts frames with changes

const REPORT = ["epoch", "sequence", "utc_ms", "position_ms", "latitude_deg", "longitude_deg", "height_m", "north_m_s", "east_m_s", "level_m", "verdict", "verdict_since_ms"];

// Takes a row of a vehicle that was asked for, or heard of, at `at` [ms of this page]; gives it with the newest report that is known.
export function newestOf(row, at) {
  const known = newest.get(row.vehicle);
  const isOld = known && (known.report.epoch === row.epoch ? known.report.sequence > row.sequence : known.at > at);
  if (row.utc_ms != null && isOld) return { ...row, ...known.report };
  newest.delete(row.vehicle);
  if (row.utc_ms == null) return row; // nothing is kept of it any more
  newest.set(row.vehicle, { at, report: Object.fromEntries(REPORT.filter((key) => key in row).map((key) => [key, row[key]])) });
  if (newest.size > REMEMBERED) newest.delete(newest.keys().next().value);
  return row;
}

let offsetMs = 0; // of the centre's clock
let attempts = 0;
let frameAt = 0;
let socket = null;

export const centreMs = () => Date.now() + offsetMs;
export const may = (right) => session.value?.rights?.includes(right) ?? false;

// Calls `listener` with each frame that holds changes, until the returned function is called.
export function onFrame(listener) {
  listeners.add(listener);
  return () => listeners.delete(listener);
}

export class Refused extends Error {}

async function content(answer) {
  if (answer.status === 401) toLogin();
  const body = await answer.json().catch(() => ({}));
  if (!answer.ok) throw Object.assign(new Refused(typeof body.detail === "string" ? body.detail : `status ${answer.status}`), { status: answer.status });
  return body;
}

// An answer sets the clock when it arrives, and never again: what is shown of it later has aged since.
export async function ask(path) {
  const body = await content(await fetch(path, { signal: AbortSignal.timeout(ANSWER_MS) }));
  if (typeof body.now_ms === "number") offsetMs = body.now_ms - Date.now();
  return body;
}
export const send = async (path, body) => content(await change(path, body));
export const reason = (error) => (error instanceof Refused ? w.refused(error.message) : w.noAnswer);

function connect() {
  const opening = new WebSocket(socketAddress("ws"));
  socket = opening;
  opening.onmessage = (event) => {
    const frame = JSON.parse(event.data);
    frameAt = performance.now();
    attempts = 0;
    if (!link.value.open || link.value.bus !== frame.bus) {
      const again = link.value.lostAt !== null;
      link.value = { open: true, bus: frame.bus, lostAt: null };
      if (again) frame.many = true; // what changed meanwhile is not known: everything is asked anew
    }
    if (frame.alarms.length) alarmsRaised.value += 1;
    for (const row of frame.changes) newestOf(row, frameAt);
    if (frame.changes.length) heard.value += 1;
    if (frame.many || frame.changes.length || frame.alarms.length) for (const listener of listeners) listener(frame);
  };
  opening.onclose = (event) => {
    if (opening !== socket) return;
    if (event.code === 4401) return toLogin();
    link.value = { ...link.value, open: false, lostAt: link.value.lostAt ?? performance.now() };
    setTimeout(connect, 1000 * BACKOFF_S[Math.min(attempts, BACKOFF_S.length - 1)]);
    attempts += 1;
    fetch("api/session").then((answer) => answer.json()).then((who) => !who.role && toLogin(), () => {});
  };
}

export function start() {
  if (may("see")) connect();
  setInterval(() => {
    clock.value = performance.now();
    if (link.value.open && performance.now() - frameAt > 1000 * SILENT_S) socket?.close();
  }, 500);
}
