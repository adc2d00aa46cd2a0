// What the page knows: the state as the server sent it, the link to the server, and the server's clock.
import { signal } from "@preact/signals";

const BACKOFF_S = [0.5, 1, 2, 5];
const FULL_AGAIN_S = 10; // there are as many viewers as the unit allows
const FRAME_OVERDUE_S = 2; // frames come five times a second
const ANSWER_MS = 5000;
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

// Times as the viewer reads them: UTC, or the time of the browser's place.
const isLocal = () => settings.value.clock === "local";

// The same moment, whose UTC fields are those of the chosen clock.
function shown(ms) {
  const date = new Date(ms);
  return isLocal() ? new Date(ms - date.getTimezoneOffset() * 60000) : date;
}

export const timeOfDay = (ms, tenths = false) => shown(ms).toISOString().slice(11, tenths ? 21 : 19);
export const dayOf = (ms) => shown(ms).toISOString().slice(0, 10);

// Name of the clock at a moment: daylight saving time has another.
export function zone(ms = Date.now()) {
  if (!isLocal()) return "UTC";
  const minutes = -new Date(ms).getTimezoneOffset();
  const [hours, rest] = [Math.floor(Math.abs(minutes) / 60), Math.abs(minutes) % 60];
  return minutes === 0 ? "UTC" : `UTC${minutes < 0 ? "\u2212" : "+"}${hours}${rest ? `:${String(rest).padStart(2, "0")}` : ""}`;
}

export let history = { time_ns: [], fields: {} }; // as shown

let recent = history; // as received; another object only while the page is paused
let frozen = null; // while the page is paused: its time, and whether it was live
let newest = null; // time of the newest frame [ms], performance.now() then, and how fast that time runs
let lastFrameAt = 0;
let sequence = -1;
let version = null;
let socket = null;
const PACKED = typeof DecompressionStream === "function";
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

// Milliseconds on the unit's time line; it goes on between frames, at the speed of a replay, and stands while the page
// is paused.
const runningMs = () => (newest === null ? null : newest.ms + (performance.now() - newest.at) * newest.rate);
export const nowMs = () => (frozen ? frozen.nowMs : runningMs());
const frameAgeS = () => (lastFrameAt ? (performance.now() - lastFrameAt) / 1000 : null);
const receives = () => link.value.open && frameAgeS() !== null && frameAgeS() < FRAME_OVERDUE_S;
export const isLive = () => (frozen ? frozen.live : receives());
export const connected = () => (frozen ? frozen.open : link.value.open);
export const brokerAnswers = () => connected() && state.value.chain.broker.ok; // else no process is known

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
  if (state.value?.topics[topic]?.earlier) return age >= row.stale_after_s ? "stale" : "earlier"; // of before a restart
  if (age >= row.stale_after_s) return "stale";
  return age >= row.late_after_s ? "late" : "fresh";
}

// Whether a value must not be shown as live.
export const isOld = (topic, stampNs) => ["stale", "never", "earlier"].includes(freshness(topic, stampNs));

// Whether the solution must not be shown as the present position: it is old, or the verdict says that there is none.
export const isPast = (solution) => state.value.banner.state === "no_fix" || isOld("navigation/solution", solution.updated_ns);

const isObject = (value) => value !== null && typeof value === "object" && !Array.isArray(value);

// What `difference` of the server's stream/patch.py states: objects merge, everything else replaces, and exactly the keys
// of `removed`, each a path, are deleted. In a Map no name of a key has another meaning, as __proto__ has in an object.
export function merge(old, changed, removed = []) {
  const merged = new Map(Object.entries(old));
  for (const [key, value] of Object.entries(changed)) {
    const before = merged.get(key);
    merged.set(key, isObject(before) && isObject(value) ? merge(before, value) : value);
  }
  for (const [key, ...rest] of removed) {
    if (rest.length === 0) merged.delete(key);
    else merged.set(key, merge(merged.get(key), {}, [rest]));
  }
  return Object.fromEntries(merged);
}

function note(view) {
  const live = (topic, value) => {
    const limits = contract.value.topics[topic];
    return value && !view.topics[topic]?.earlier && (view.now_ns - value.updated_ns) / 1e9 < limits.stale_after_s ? value : null;
  };
  const s = live("navigation/solution", view.solution);
  const fix = live("gnss/fix", view.fix);
  const row = {
    latitude_deg: s?.latitude_deg,
    longitude_deg: s?.longitude_deg,
    speed_fused_m_s: s?.speed_m_s,
    speed_gnss_m_s: fix?.ground_speed_m_s,
    speed_odometer_m_s: view.odometer?.speed_m_s,
  };
  recent.time_ns.push(view.now_ns);
  for (const name of Object.keys(row)) (recent.fields[name] ??= []).push(row[name] ?? null);
  let old = 0;
  while (recent.time_ns[old] < view.now_ns - HISTORY_S * 1e9) old += 1;
  recent.time_ns.splice(0, old);
  for (const column of Object.values(recent.fields)) column.splice(0, column.length - recent.time_ns.length);
}

function replaceRecent(past) {
  recent = past;
  if (!paused.value) history = recent;
}

// After a jump of a replay the plots show the minute before the new position.
function recall() {
  replaceRecent({ time_ns: [], fields: {} });
  clearTimeout(recalling);
  recalling = setTimeout(async () => {
    const jump = epoch;
    try {
      const answer = await fetch(`api/history?seconds=${HISTORY_S}&fields=${PLOTTED.join(",")}`, { signal: AbortSignal.timeout(3000) });
      const past = await answer.json();
      if (answer.ok && jump === epoch) replaceRecent(past);
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
    replaceRecent(frame.history);
    held = frame.state;
  } else {
    if (frame.sequence !== sequence + 1) return socket.close();
    held = merge(held, frame.state, frame.removed);
  }
  sequence = frame.sequence;
  const replay = held.replay;
  newest = { ms: held.now_ns / 1e6, at: lastFrameAt, rate: !replay ? 1 : replay.playing ? replay.speed : 0 };
  if (replay && replay.epoch !== epoch && frame.kind === "difference") recall();
  epoch = replay?.epoch;
  if (frame.kind === "difference") note(held);
  if (!paused.value) state.value = held;
}

// Why there is no connection, as far as an ordinary request can tell.
async function findReason() {
  try {
    const answer = await fetch("api/viewers", { signal: AbortSignal.timeout(3000) });
    if (answer.status === 401) toLogin();
    if (!answer.ok) return { why: answer.status === 421 ? "name" : "error" };
    const viewers = await answer.json();
    return { why: viewers.connected >= viewers.maximum ? "full" : "interrupted", viewers };
  } catch {
    return { why: "unreachable" };
  }
}

async function lost() {
  const before = link.value;
  const attempts = before.attempts + 1;
  link.value = { ...before, open: false, lostAt: before.lostAt ?? performance.now(), attempts, gap: null };
  const waitS = before.why === "full" ? FULL_AGAIN_S : BACKOFF_S[Math.min(attempts - 1, BACKOFF_S.length - 1)];
  setTimeout(connect, 1000 * waitS);
  const found = await findReason();
  if (!link.value.open) link.value = { ...link.value, ...found };
}

// Every address is relative to the document, so that the page works below any path.
export const socketAddress = (path) => new URL(path, document.baseURI).href.replace(/^http/, "ws");

const unpack = (data) => (typeof data === "string" ? JSON.parse(data)
  : new Response(data.stream().pipeThrough(new DecompressionStream("deflate"))).json());

function connect() {
  const opening = new WebSocket(socketAddress(`ws${PACKED ? "?packed=1" : ""}`));
  socket = opening;
  let before = Promise.resolve(); // frames are taken in their order, though they are unpacked in the background
  opening.onmessage = (event) => {
    const frame = unpack(event.data);
    before = before.then(async () => receive(opening, await frame));
  };
  opening.onclose = () => {
    if (opening !== socket) return;
    socket = null; // a frame that is still being unpacked is of a connection that is over
    lost();
  };
}

function receive(from, frame) {
  if (from !== socket) return;
  take(frame);
  if (!link.value.open) {
    const gap = link.value.lostAt === null ? null : (performance.now() - link.value.lostAt) / 1000;
    link.value = { open: true, lostAt: null, why: null, gap, attempts: 0 };
  }
}

export function start() {
  connect();
  setInterval(() => {
    clock.value = performance.now();
    // A server that hangs keeps its connection open: notice the silence and start afresh.
    if (link.value.open && frameAgeS() > 5) socket?.close();
  }, 200);
}

// Paused, the page stands as it was: its values, their ages, its plots and what it says of the connection.
export function togglePause() {
  if (!state.value) return;
  if (paused.value) {
    frozen = null;
    history = recent;
    state.value = held;
  } else {
    frozen = { nowMs: runningMs(), live: receives(), open: link.value.open };
    history = structuredClone(recent);
  }
  paused.value = !paused.value;
}

// The login of this page, and changes that the unit accepts from it: in this file, since each further one is a request.
export const session = signal(null); // as /api/session states it

export async function renew() {
  const answer = await fetch("api/session", { signal: AbortSignal.timeout(ANSWER_MS) });
  if (answer.ok) session.value = await answer.json();
  return session.value;
}

// The page that is shown stays behind the #, so that the login comes back to it.
export const toLogin = () => location.replace(`login${location.hash}`);

const FILE_MS = 60000; // a file is sent and looked through
const post = (path, command) => fetch(path, {
  method: "POST",
  headers: { "Content-Type": command instanceof Blob ? "text/csv" : "application/json", "X-OBU-CSRF": session.value?.csrf ?? "" },
  body: command instanceof Blob ? command : JSON.stringify(command),
  signal: AbortSignal.timeout(command instanceof Blob ? FILE_MS : ANSWER_MS),
});

// Send a command. Its header proves that this page sends it; after a restart of the unit the value is another one.
export async function change(path, command) {
  if (!session.value) await renew();
  const used = session.value?.csrf;
  let answer = await post(path, command);
  if (answer.status === 403 && (await renew())?.csrf !== used) answer = await post(path, command);
  if (answer.status === 401) toLogin();
  return answer;
}

const TOLD_MOST = 20; // texts of errors in the life of a page

// Sends each error that was not caught to the unit, which counts it: nobody may be looking at the browser's console.
export function tellErrors() {
  const told = new Set();
  const folder = new URL(".", document.baseURI).href;
  const tell = async (error) => {
    const message = String(error).slice(0, 400);
    if (told.has(message) || told.size >= TOLD_MOST) return;
    told.add(message);
    const lines = String(error?.stack ?? "").replaceAll(folder, "").match(/[\w./-]+\.js:\d+:\d+/g) ?? [];
    const page = location.hash.replace(/^#\/?/, "").split(/[?/]/)[0].slice(0, 40);
    try {
      if (!session.value) await renew();
      await post("api/page-error", { page, message, place: lines.slice(0, 4).join(" ").slice(0, 400) });
    } catch {
      // Without a connection the unit cannot be told; the browser's console has the error.
    }
  };
  addEventListener("error", (event) => event.error && tell(event.error)); // without an object it is a notice of the browser
  addEventListener("unhandledrejection", (event) => tell(event.reason));
}

export async function logOut() {
  await change("api/logout", {});
  location.replace("login");
}
