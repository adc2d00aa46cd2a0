// What the page knows: the state as the server told it, the link to the server, and the server's clock.
import { signal } from "@preact/signals";

const BACKOFF_S = [0.5, 1, 2, 5];
const FRAME_OVERDUE_S = 2; // frames come five times a second
const HISTORY_S = 60;
const RECALL_MS = 150; // after the last of several jumps
const PLOTTED = ["latitude_deg", "longitude_deg", "speed_fused_m_s", "speed_gnss_m_s", "speed_odometer_m_s"];

export const state = signal(null);
export const contract = signal(null);
export const link = signal({ open: false, lostAt: null, why: null, gap: null, attempts: 0 });
export const clock = signal(0); // ticks five times a second, so that ages go on when frames do not
export const paused = signal(false);
export const outdated = signal(false); // the server has a newer edition of this page
export const settings = signal(read("obu-settings", { theme: "auto", headingUp: false, shortcuts: true }));

export let history = { time_ns: [], fields: {} };

let newest = null; // time of the newest frame [ms], performance.now() then, and how fast that time runs
let lastFrameAt = 0;
let sequence = -1;
let version = null;
let socket = null;
let epoch; // jumps of a replay
let recalling = null;
let held = null; // what came while the display is paused

export function remember(changes) {
  settings.value = { ...settings.value, ...changes };
  try {
    localStorage.setItem("obu-settings", JSON.stringify(settings.value));
  } catch {
    // Private windows may refuse storage; the setting then lasts as long as the page.
  }
}

function read(key, fallback) {
  try {
    return { ...fallback, ...JSON.parse(localStorage.getItem(key) || "{}") };
  } catch {
    return fallback;
  }
}

// Milliseconds on the unit's time line; it goes on between frames, at the speed of a replay.
export const nowMs = () => (newest === null ? null : newest.ms + (performance.now() - newest.at) * newest.rate);
export const frameAgeS = () => (lastFrameAt ? (performance.now() - lastFrameAt) / 1000 : null);
export const brokerAnswers = () => link.value.open && state.value.chain.broker.ok; // else no process is known
export const isLive = () => link.value.open && frameAgeS() !== null && frameAgeS() < FRAME_OVERDUE_S;

export function ageS(stampNs) {
  const now = nowMs();
  return stampNs == null || now === null ? null : Math.max(0, (now - stampNs / 1e6) / 1000);
}

// The limits come from the server, which has the one rule; here they are only compared.
export function freshness(topic, stampNs) {
  const age = ageS(stampNs);
  const row = contract.value?.topics[topic] ?? contract.value?.topics[topic.replace(/\/[^/]*$/, "/+")];
  if (row?.stale_after_s === null) return "quiet"; // events: their silence says nothing, not even at the start
  if (age === null) return "never";
  if (!row) return "quiet";
  if (age >= row.stale_after_s) return "stale";
  return age >= row.late_after_s ? "late" : "fresh";
}

function merge(old, changes) {
  if (old === null || typeof old !== "object" || Array.isArray(old)) return changes;
  const merged = { ...old };
  for (const [key, value] of Object.entries(changes)) {
    const both = value && typeof value === "object" && !Array.isArray(value);
    merged[key] = both ? merge(merged[key] ?? null, value) : value;
  }
  return merged;
}

function note(view) {
  const s = view.solution && freshness("navigation/solution", view.solution.updated_ns) !== "stale" ? view.solution : null;
  const fix = view.fix && freshness("gnss/fix", view.fix.updated_ns) !== "stale" ? view.fix : null;
  const row = {
    latitude_deg: s?.latitude_deg,
    longitude_deg: s?.longitude_deg,
    speed_fused_m_s: s?.speed_m_s,
    speed_gnss_m_s: fix?.ground_speed_m_s,
    speed_odometer_m_s: view.odometer?.speed_m_s,
  };
  history.time_ns.push(view.now_ns);
  for (const name of Object.keys(row)) (history.fields[name] ??= []).push(row[name] ?? null);
  let old = 0;
  while (history.time_ns[old] < view.now_ns - HISTORY_S * 1e9) old += 1;
  history.time_ns.splice(0, old);
  for (const column of Object.values(history.fields)) column.splice(0, column.length - history.time_ns.length);
}

// After a jump of a replay the plots show the minute before the new position.
function recall() {
  history = { time_ns: [], fields: {} };
  clearTimeout(recalling);
  recalling = setTimeout(async () => {
    const jump = epoch;
    try {
      const answer = await fetch(`/api/history?seconds=${HISTORY_S}&fields=${PLOTTED.join(",")}`, { signal: AbortSignal.timeout(3000) });
      const past = await answer.json();
      if (answer.ok && jump === epoch) history = past;
    } catch {
      // The plots then begin at the new position.
    }
  }, RECALL_MS);
}

function take(frame) {
  lastFrameAt = performance.now();
  if (frame.kind === "snapshot") {
    outdated.value = version !== null && version !== frame.version;
    version ??= frame.version;
    contract.value = frame.contract;
    history = frame.history;
    held = frame.state;
  } else {
    if (frame.sequence !== sequence + 1) return socket.close();
    held = merge(held, frame.state);
  }
  sequence = frame.sequence;
  const replay = held.replay;
  newest = { ms: held.now_ns / 1e6, at: lastFrameAt, rate: !replay ? 1 : replay.playing ? replay.speed : 0 };
  if (replay && replay.epoch !== epoch && frame.kind === "difference") recall();
  epoch = replay?.epoch;
  if (frame.kind === "difference") note(held);
  if (!paused.value) state.value = held;
}

async function findReason() {
  try {
    const answer = await fetch("/api/health", { signal: AbortSignal.timeout(3000) });
    return answer.ok || answer.status === 503 ? "full" : answer.status === 421 ? "name" : "error";
  } catch {
    return "unreachable";
  }
}

async function lost() {
  const before = link.value;
  const attempts = before.attempts + 1;
  link.value = { ...before, open: false, lostAt: before.lostAt ?? performance.now(), attempts, gap: null };
  setTimeout(connect, 1000 * BACKOFF_S[Math.min(attempts - 1, BACKOFF_S.length - 1)]);
  const why = await findReason();
  if (!link.value.open) link.value = { ...link.value, why };
}

function connect() {
  const opening = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/ws`);
  socket = opening;
  opening.onmessage = (event) => {
    if (opening !== socket) return;
    take(JSON.parse(event.data));
    if (!link.value.open) {
      const gap = link.value.lostAt === null ? null : (performance.now() - link.value.lostAt) / 1000;
      link.value = { open: true, lostAt: null, why: null, gap, attempts: 0 };
    }
  };
  opening.onclose = () => opening === socket && lost();
}

export function start() {
  connect();
  setInterval(() => {
    clock.value = performance.now();
    // A server that hangs keeps its connection open: notice the silence and start afresh.
    if (link.value.open && frameAgeS() > 5) socket.close();
  }, 200);
}

export function togglePause() {
  paused.value = !paused.value;
  if (!paused.value && held) state.value = held;
}
