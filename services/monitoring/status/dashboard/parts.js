// Small parts that every page uses: icons, numbers with units, ages, cards.
import { Component, h } from "preact";
import { useEffect, useLayoutEffect, useRef } from "preact/hooks";
import { signal } from "@preact/signals";
import htm from "htm";
import { ageS, clock, connected, dayOf, freshness, isLive, link, paused, settings, state, timeOfDay } from "./store.js";
import { words } from "./words.js";

export const html = htm.bind(h);

const SHAPES = {
  safe: html`<circle cx="12" cy="12" r="10" fill="currentColor" /><path d="m7 12.5 3.5 3.5 6.5-7.5" class="cut" />`,
  caution: html`<path d="M12 2.5 22.5 21h-21z" fill="currentColor" stroke="currentColor" stroke-linejoin="round" />
    <path d="M12 9v5.5m0 3v.2" class="cut" />`,
  unsafe: html`<path d="M8 2h8l6 6v8l-6 6H8l-6-6V8z" fill="currentColor" /><path d="m8.5 8.5 7 7m0-7-7 7" class="cut" />`,
  stale: html`<circle cx="12" cy="12" r="9" class="line" stroke-dasharray="4 3.1" />`,
  above_limit: html`<path d="M3 2h18v20H3z" fill="currentColor" /><path d="M6 6h12M12 19V10m-4 4 4-4 4 4" class="cut" />`,
  gap: html`<path d="M3 12h4m10 0h4" class="line" />`,
  starting: html`<circle cx="12" cy="12" r="9" class="line" stroke-dasharray="1.5 3.2" /><path d="M7.5 12h.2m4.2 0h.2m4.2 0h.2" class="line" />`,
  broker_lost: html`<path d="M9.5 8.5 6 12a4.2 4.2 0 0 0 6 6l1.5-1.5M14.500 15.500 18 12a4.2 4.2 0 0 0-6-6l-1.500 1.500" class="line" /><path d="m4 4 16 16" class="line" />`,
  disconnected: html`<path d="M3 9a13 13 0 0 1 18 0M6.500 13a8 8 0 0 1 11 0M12 18v.2" class="line" /><path d="M20 4 4 20" class="line" />`,
  dead_reckoning: html`<path d="M12 2 22 12 12 22 2 12z" fill="currentColor" /><path d="M8 12h8m-3-3.5 3 3.5-3 3.5" class="cut" />`,
  no_fix: html`<rect x="2.5" y="2.5" width="19" height="19" rx="3" fill="currentColor" /><path d="M7 12h10" class="cut" />`,
  initialising: html`<circle cx="12" cy="12" r="9" class="line" /><path d="M12 6.5V12l3.5 2.5" class="line" />`,
  trust: html`<path d="M12 3 4.5 6v5.5c0 4.5 3 7.6 7.5 9.5 4.5-1.9 7.5-5 7.5-9.5V6z" class="line" /><path d="m8.7 12 2.4 2.4 4.4-4.8" class="line" />`,
  toll: html`<path d="M4 21V4h5v17M9 9l12-3M2 21h9" class="line" />`,
  off: html`<circle cx="12" cy="12" r="9" class="line" /><path d="M6 18 18 6" class="line" />`,
  info: html`<rect x="3" y="3" width="18" height="18" rx="3" fill="currentColor" /><path d="M12 11v6m0-10v.2" class="cut" />`,
  now: html`<path d="m12 3 7 17-7-4-7 4z" class="line" />`,
  map: html`<path d="m3 6 6-2 6 2 6-2v14l-6 2-6-2-6 2zM9 4v14m6-12v14" class="line" />`,
  system: html`<path d="M4 5h16M4 12h16M4 19h16" class="line" /><circle cx="9" cy="5" r="2" fill="currentColor" />
    <circle cx="15" cy="12" r="2" fill="currentColor" /><circle cx="8" cy="19" r="2" fill="currentColor" />`,
  set_up: html`<path d="M14 4a5 5 0 0 0-1 7L4 20l2 2 9-9a5 5 0 0 0 6-6l-3 3-3-1-1-3z" class="line" />`,
  settings: html`<circle cx="12" cy="12" r="3" class="line" /><path d="M12 3v4M12 17v4M3 12h4M17 12h4M5.6 5.6l2.9 2.9M15.5 15.5l2.9 2.9M18.4 5.6l-2.9 2.9M8.5 15.5l-2.9 2.9" class="line" />`,
  gnss: html`<path d="M12 12 20 4M6 12a6 6 0 0 0 6 6M2.5 12a9.5 9.5 0 0 0 9.5 9.5" class="line" /><circle cx="12" cy="12" r="2.5" fill="currentColor" /><circle cx="19" cy="5" r="2.5" fill="currentColor" />`,
  charts: html`<path d="M4 4v16h16" class="line" /><path d="m7 15 4-5 3 3 5-7" class="line" />`,
  sun: html`<circle cx="12" cy="12" r="4" class="line" />
    <path d="M12 2v3m0 14v3M2 12h3m14 0h3M5 5l2 2m10 10 2 2M5 19l2-2M17 7l2-2" class="line" />`,
  logOut: html`<path d="M14 4H6a1 1 0 0 0-1 1v14a1 1 0 0 0 1 1h8M10 12h10m-4-4 4 4-4 4" class="line" />`,
  help: html`<circle cx="12" cy="12" r="9" class="line" /><path d="M9.5 9.5a2.5 2.5 0 1 1 3.5 2.3c-.7.4-1 .9-1 1.7m0 3v.2" class="line" />`,
  close: html`<path d="m6 6 12 12M18 6 6 18" class="line" />`,
  plus: html`<path d="M12 5v14M5 12h14" class="line" />`,
  minus: html`<path d="M5 12h14" class="line" />`,
  recordings: html`<rect x="3" y="5" width="18" height="14" rx="2" class="line" /><circle cx="9" cy="12" r="2.5" class="line" /><circle cx="15.5" cy="12" r="2.5" class="line" />`,
  play: html`<path d="M7 4.5v15l12-7.5z" fill="currentColor" />`,
  pause: html`<path d="M8 5v14M16 5v14" class="line" />`,
  next: html`<path d="m9 5 7 7-7 7" class="line" />`,
};

export const Icon = ({ name, class: extra = "" }) =>
  html`<svg class="icon ${extra}" viewBox="0 0 24 24" aria-hidden="true" focusable="false">${SHAPES[name]}</svg>`;

// A state as shape and colour; the word is beside it or read aloud.
export const StateIcon = ({ state, word }) =>
  html`<span class="state ${state}"><${Icon} name=${state} />${word !== "" && html`<span class="sr">${word ?? words.trust[state]}: </span>`}</span>`;

export const STATUS_STATE = {
  ready: "safe", late: "caution", restarting: "caution", stale: "stale", lost: "unsafe", ended: "off",
  waiting: "info", missing: "unsafe", absent: "off", unknown: "stale",
};
export const FRESH_STATE = { fresh: "safe", late: "caution", stale: "stale", earlier: "starting", never: "off", quiet: "info" };

export const fixed = (value, digits) => (value == null ? words.age.bar : value.toFixed(digits));

// The viewer's units of speed and of length: factor of what messages hold, and how it is written.
const SPEEDS = { "km/h": 3.6, mph: 3600 / 1609.344, kn: 3600 / 1852 };
const FEET = 1 / 0.3048;
export const speedUnit = () => (settings.value.speed in SPEEDS ? settings.value.speed : "km/h");
export const speedFactor = () => SPEEDS[speedUnit()];
export const inFeet = () => settings.value.length === "ft";
export const lengthUnit = () => (inFeet() ? ["ft", words.lengthNames.ft] : ["m", words.lengthNames.m]);
export const lengthFactor = () => (inFeet() ? FEET : 1);

// A length, in metres or in the viewer's feet.
export function metres(value) {
  if (value == null) return words.age.bar;
  if (inFeet()) {
    const feet = value * FEET;
    return feet >= 5280 ? `${(feet / 5280).toFixed(feet < 52800 ? 1 : 0)} mi` : `${feet.toFixed(feet < 20 ? 1 : 0)} ft`;
  }
  if (value >= 1000) return `${(value / 1000).toFixed(value < 10000 ? 1 : 0)} km`;
  return `${value.toFixed(value < 1 ? 2 : value < 20 ? 1 : 0)} m`;
}

export function seconds(value) {
  if (value == null) return words.age.bar;
  if (value < 0.001) return `${(value * 1e6).toFixed(0)} µs`;
  if (value < 1) return `${(value * 1000).toFixed(value < 0.01 ? 1 : 0)} ms`;
  return duration(value);
}

// A span that people read: it does not twitch below a second.
export function duration(value) {
  if (value < 60) return `${Math.floor(value)} s`;
  if (value < 3600) return `${Math.floor(value / 60)} min ${String(Math.floor(value % 60)).padStart(2, "0")} s`;
  if (value < 86400) return `${Math.floor(value / 3600)} h ${String(Math.floor((value % 3600) / 60)).padStart(2, "0")} min`;
  return `${Math.floor(value / 86400)} d ${Math.floor((value % 86400) / 3600)} h`;
}

export function bytes(value) {
  if (value == null) return words.age.bar;
  for (const [unit, size] of [["GB", 1e9], ["MB", 1e6], ["kB", 1e3]]) {
    if (value >= size) return `${(value / size).toFixed(value < 10 * size ? 1 : 0)} ${unit}`;
  }
  return `${value} B`;
}

export const rate = (value) => (value == null ? words.age.bar : value >= 10 ? value.toFixed(0) : value.toFixed(1));
export const percent = (share) => (share == null ? words.age.bar : `${(share * 100).toFixed(share < 0.0995 ? 1 : 0)} %`);
export { dayOf, timeOfDay };
export const degrees = (rad) => (rad * 180) / Math.PI;
export const compass = (rad) => ((degrees(rad) % 360) + 360) % 360;

// How old a value is, in words that change their form when it is late or stale.
export function Age({ topic, stamp }) {
  clock.value; // read, so that the age goes on growing without any message
  const age = ageS(stamp);
  const state = freshness(topic, stamp);
  const text =
    age === null ? words.age.never
    : state === "stale" ? words.age.stale(timeOfDay(stamp / 1e6), duration(age))
    : state === "earlier" ? words.age.earlier(duration(age))
    : state === "late" ? words.age.late(age < 10 ? `${age.toFixed(1)} s` : duration(age))
    : age < 1 ? words.age.now
    : duration(age);
  return html`<span class="age ${state}">${text}</span>`;
}

const PHONE = matchMedia("(max-width: 700px)");
const onPhone = signal(PHONE.matches);
PHONE.addEventListener("change", () => { onPhone.value = PHONE.matches; });
const unfolded = signal(new Set()); // cards that were opened on a phone, until the page is loaded again

export function unfold(id, open = true) {
  const cards = new Set(unfolded.value);
  if (open) cards.add(id);
  else cards.delete(id);
  unfolded.value = cards;
}

// With `fold` a card is its title and note on a phone, until it is pressed: what comes first on a page is not pushed off
// it. A card that asks or warns is not to be folded: its `fold` is false meanwhile.
export function Card({ title, note, class: extra = "", aside, id, fold, children }) {
  const folds = fold && onPhone.value;
  const open = !folds || unfolded.value.has(id);
  const head = folds ? html`<button class="card-fold" aria-expanded=${open} onClick=${() => unfold(id, !open)}>${title}</button>` : title;
  return html`<section class="card ${extra} ${folds ? "folds" : ""} ${open ? "" : "shut"}" aria-labelledby=${id}>
    <header><h2 id=${id}>${head}</h2>${note && html`<span class="note">${note}</span>`}<span class="aside">${open && aside}</span></header>
    ${open && children}
  </section>`;
}

// One line of a definition list; the unit's full name is what a screen reader says.
export const Row = ({ label, value, unit, unitName, extra, dim }) => html`<div class="row">
  <dt>${label}</dt>
  <dd class=${dim ? "dim" : ""}>
    <span class="value">${value}</span>${unit && html`<span class="unit" aria-hidden=${unitName ? "true" : null}>${" "}${unit}</span>`}${unitName && html`<span class="sr">${" "}${unitName}</span>`}${extra && html`<span class="extra">${" "}${extra}</span>`}
  </dd>
</div>`;

export const Empty = ({ title, why, what }) => html`<div class="empty">
  <${Icon} name="stale" /><p><strong>${title}</strong></p>${why && html`<p>${why}</p>`}${what && html`<p>${what}</p>`}
</div>`;

// Shows what is inside. If that fails, a sentence stands in its place and everything around it goes on; the error is
// reported as one that was not caught, which the shell sends to the unit.
export class Guard extends Component {
  componentDidCatch(error) {
    this.setState({ failed: true });
    reportError(error);
  }

  render({ children }, { failed }) {
    return failed ? html`<div role="alert"><${Empty} title=${words.failed.title} why=${words.failed.why} what=${html`<button onClick=${() => location.reload()}>${words.failed.reload}</button>`} /></div>` : children;
  }
}

// A modal drawer: the browser's own dialog keeps the focus inside and gives it back.
// What became of each kind of message of a device: used, known and not used, not known, rejected with its reason.
export function KindsTable({ kinds }) {
  const w = words.system;
  if (kinds.length === 0) return null;
  return html`<h3 class="divide">${w.kinds}</h3><div class="scroll" tabindex="0" role="group" aria-label=${w.kinds}><table class="plain kinds">
    <thead><tr><th scope="col">${w.kind}</th><th scope="col">${w.use}</th><th scope="col" class="number">${w.count}</th><th scope="col" class="number">${w.rejected}</th></tr></thead>
    <tbody>${kinds.map((k) => html`<tr key=${k.kind}><th scope="row">${k.kind}</th><td>${w.uses[k.use]}</td><td class="number">${k.count}</td><td class="number">${k.rejected > 0 ? `${k.rejected} (${k.reason})` : "0"}</td></tr>`)}</tbody></table></div>`;
}

export function Drawer({ title, onClose, children, head, wide }) {
  const ref = useRef(null);
  useLayoutEffect(() => {
    ref.current.showModal();
  }, []);
  return html`<dialog ref=${ref} class="drawer ${wide ? "wide" : ""}" aria-labelledby="drawer-title"
    onClose=${onClose} onClick=${(event) => event.target === ref.current && ref.current.close()}>
    <div class="inside">
      <header>
        <h2 id="drawer-title">${title}</h2>${head}
        <button class="ghost icon-only" onClick=${() => ref.current.close()} aria-label=${words.close}><${Icon} name="close" /></button>
      </header>
      ${children}
    </div>
  </dialog>`;
}

// navigator.clipboard exists only over HTTPS; a unit on a local network is plain HTTP.
// Let the browser save what this page holds.
export function saveAs(blob, name) {
  const address = URL.createObjectURL(blob);
  Object.assign(document.createElement("a"), { href: address, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(address), 60000);
}

export async function copyText(text) {
  if (navigator.clipboard && window.isSecureContext) {
    await navigator.clipboard.writeText(text);
    return;
  }
  const area = document.createElement("textarea");
  area.value = text;
  area.className = "sr";
  (document.querySelector("dialog[open]") ?? document.body).append(area);
  area.select();
  document.execCommand("copy");
  area.remove();
}

// The checks behind the banner; without a connection none of them is known to hold any more.
export const checksNow = (banner) => (isLive() ? banner.checks
  : banner.checks.map((c) => ({ ...c, state: "stale", text: words.status.unknown, ratio: null })));

// The browser's first language in which the server says something.
export const languageOf = (row) => navigator.languages?.map((one) => one.slice(0, 2)).find((one) => one === "en" || row.languages?.[one]);

// A row's text in the browser's language, else in English.
export const told = (row, english) => row.languages?.[languageOf(row)] ?? english;

// What the banner says: the server's words in the browser's language, or that the connection is lost and so no verdict is known.
export function verdict() {
  const banner = state.value?.banner;
  if (!banner && link.value.why === "full") return { state: "disconnected", word: words.trust.disconnected, sentence: words.lost.full(link.value.viewers.connected), since_ns: null };
  if (!banner) return { state: "starting", word: words.trust.starting, sentence: words.connecting, since_ns: null };
  const lostS = link.value.lostAt === null ? 0 : (performance.now() - link.value.lostAt) / 1000;
  if (!isLive() && (paused.value || lostS > 1 || connected())) return { ...banner, state: "disconnected", word: words.trust.disconnected, sentence: words.banner.disconnected, action: null, since_ns: state.value.now_ns };
  const language = languageOf(banner);
  // The centre may have put a sentence of its own in place of the unit's.
  return banner.languages?.[language] && banner.state !== "disconnected" ? { ...banner, ...banner.languages[language], language } : banner;
}

const UNKNOWN = ["stale", "starting", "broker_lost", "disconnected"];
export const verdictStands = () => !UNKNOWN.includes(verdict().state);
export const monitorsStand = () => verdictStands() && verdict().state !== "no_fix"; // without a position they judge nothing

export const SPAN_S = 900; // of the bands

// Spans of the last quarter of an hour, of a list of changes.
export function bandsOf(changes, nowNs) {
  const from = nowNs - SPAN_S * 1e9;
  return changes
    .map((entry, i) => ({ state: entry.state, from: Math.max(entry.since_ns, from), to: changes[i + 1]?.since_ns ?? nowNs }))
    .filter((span) => span.to > from);
}

export function Band({ bands, nowNs }) {
  const share = (ns) => `${(100 * ns) / (SPAN_S * 1e9)}%`;
  const listed = bands.slice(-6).map((b) => `${words.trust[b.state]} ${duration((b.to - b.from) / 1e9)}`).join(", ");
  return html`<div class="band" role="img" aria-label=${words.trustCard.label(listed)}>
    ${bands.map((b) => html`<span class="segment ${b.state}" title=${words.trust[b.state]} style=${{ left: share(b.from - nowNs + SPAN_S * 1e9), width: share(b.to - b.from) }}></span>`)}
  </div>`;
}

export function themeName() {
  const dark = window.matchMedia("(prefers-color-scheme: dark)").matches;
  return settings.value.theme === "auto" ? (dark ? "dark" : "light") : settings.value.theme;
}

let library = null; // uPlot, from the first plot on
function loadPlot() {
  library ??= new Promise((resolve, reject) => {
    const script = document.createElement("script");
    script.src = "lib/uplot.js";
    script.onload = () => resolve(window.uPlot);
    script.onerror = reject;
    document.head.append(script);
  });
  return library;
}

// References to a box and to the plot that fills it; `make(Library, size, box)` draws it anew for another shape.
export function usePlot(shape, make) {
  const box = useRef(null);
  const plot = useRef(null);
  useEffect(() => {
    let gone = false;
    const element = box.current;
    const size = () => ({ width: Math.max(element.clientWidth, 120), height: Math.max(element.clientHeight, 120) });
    const observer = new ResizeObserver(() => plot.current?.setSize(size()));
    loadPlot().then((Library) => {
      if (gone) return;
      plot.current = make(Library, size(), element);
      observer.observe(element);
    }, () => {});
    return () => {
      gone = true;
      observer.disconnect();
      plot.current?.destroy();
      plot.current = null;
    };
  }, [shape]);
  return [box, plot];
}
