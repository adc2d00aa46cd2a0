// The shell around the pages: unit, connection, the verdict in one sentence, and navigation.
import { render } from "preact";
import { useEffect, useLayoutEffect, useRef, useState } from "preact/hooks";
import { brokerAnswers, clock, connected, contract, isLive, isOld, link, logOut, nowMs, outdated, paused, remember, renew, session, settings, start, state, tellErrors, togglePause } from "./store.js";
import { Drawer, Empty, Guard, Icon, StateIcon, bytes, checksNow, copyText, duration, html, rate, seconds, timeOfDay, told, verdict, lengthUnit, speedUnit } from "./parts.js";
import { NowPage } from "./now.js";
import { words } from "./words.js";

const THEMES = ["auto", "light", "dark", "night"];
const LOST_BAR_AFTER_S = 3;
const TRY_AGAIN_MS = 2000;
const PAGES = ["now", "map", "gnss", "charts", "trust", "toll", "recordings", "system", "settings", "set_up"];
const WATCHED = ["now", "map", "gnss", "trust"];
const GO = { n: "now", m: "map", t: "trust", g: "gnss", c: "charts", l: "toll", s: "system", r: "recordings", e: "settings", u: "set_up" }; // after the key g
const HIDDEN = { rsu: ["now", "gnss", "charts", "trust", "set_up"], obu: ["toll"] }; // pages of the other role
const LATER = {
  map: () => import("./map/map.js").then((m) => m.MapPage),
  gnss: () => import("./gnss/gnss.js").then((m) => m.GnssPage),
  charts: () => import("./charts/charts.js").then((m) => m.ChartsPage),
  trust: () => import("./trust/trust.js").then((m) => m.TrustPage),
  toll: () => import("./toll/toll.js").then((m) => m.TollPage),
  recordings: () => import("./recordings/recordings.js").then((m) => m.RecordingsPage),
  system: () => import("./system/system.js").then((m) => m.SystemPage),
  settings: () => import("./settings/settings.js").then((m) => m.SettingsPage),
  set_up: () => import("./set_up/set_up.js").then((m) => m.SetUpPage),
};
const loaded = { now: NowPage }; // the others when they are first opened

function useRoute() {
  const [hash, setHash] = useState(location.hash);
  useEffect(() => {
    const changed = () => setHash(location.hash);
    addEventListener("hashchange", changed);
    return () => removeEventListener("hashchange", changed);
  }, []);
  const [path, query] = hash.replace(/^#\/?/, "").split("?");
  return { page: PAGES.includes(path) ? path : role() === "rsu" ? "toll" : "now", query: new URLSearchParams(query) };
}

const go = (hash) => {
  if (location.hash !== hash) location.hash = hash;
};

// A unit that is seen from a control centre: what it passes on, and nothing that only it can do.
const watch = () => state.value?.watch ?? null;
const role = () => (state.value?.toll ? "rsu" : "obu");
const pagesHere = () => PAGES.filter((name) => (!watch() || WATCHED.includes(name)) && !HIDDEN[role()].includes(name) && !(["recordings", "settings", "set_up"].includes(name) && state.value?.replay));

// That the vehicle is seen from afar, how old the newest message is, and the way back.
function Watch() {
  clock.value;
  const { heard_ns, last } = watch();
  const t = words.watch;
  const age = heard_ns === null ? null : Math.max(0, (nowMs() - heard_ns / 1e6) / 1000);
  const report = last && t.last(words.trust[last.verdict], duration(Math.max(0, (Date.now() - last.utc_ms) / 1000)));
  return html`<p class="origin watched" title=${t.title}><strong>${t.word}</strong><span>${age === null ? t.nothing : t.age(age < 10 ? `${age.toFixed(1)} s` : duration(age))}</span></p>
    <p><a href=${`../../../#/vehicles/${encodeURIComponent(state.value.vehicle)}`}>${t.back}</a> ${watch().silent && report && html`<span class="dim">${report}</span>`}</p>`;
}

function Origin() {
  const origin = state.value?.origin;
  const kind = origin?.kind ?? "unknown";
  const [word, name, meaning] = words.origin[kind];
  return html`${watch() && html`<${Watch} />`}<p class="origin ${kind}" title=${meaning}><strong>${word}</strong>${origin && html`<span>${name(origin)}</span>`}</p>`;
}

// Whoever drives or keeps the vehicle sees that its live data leave it.
function Watched() {
  clock.value;
  const uplink = state.value?.uplink;
  const t = words.uplink;
  const on = uplink?.watchers > 0 && !isOld("uplink/state", uplink.updated_ns);
  return html`<p class=${on ? "watched" : "sr"} role="status" title=${on ? t.watchedMeans : null}>${on && html`<strong>${t.watched}</strong> <span>${t.watchers(uplink.watchers)}</span>`}</p>`;
}

// While some have sent nothing since the start, that nothing is down says little.
const servicesOk = ({ ok, up, of }) => (ok && up < of ? null : ok); // null: not known

function links() {
  const c = state.value?.chain;
  const up = connected() && isLive();
  const known = up && c;
  return [
    ["browser", true, ""],
    ["api", up, ""],
    ["broker", known ? c.broker.ok : null, ""],
    ["services", known && c.broker.ok ? servicesOk(c.services) : null, known ? `${c.services.up}/${c.services.of}` : ""],
    ["sensors", known && c.broker.ok ? c.sensors.ok : null, known ? `${c.sensors.up}/${c.sensors.of}` : ""],
  ];
}

function worstOf(chain) {
  const t = words.chain.worst;
  const c = state.value?.chain;
  if (link.value.why === "full" && !link.value.open) return t.full;
  const worst = chain.find(([, ok]) => ok === false)?.[0];
  if (!worst) return null;
  if (worst === "services") return t.services(c.services.worst);
  if (worst === "sensors") return c.sensors.worst ? t.sensors(c.sensors.worst) : t.noSensors;
  return t[worst];
}

function Chain() {
  clock.value;
  const t = words.chain;
  const chain = links();
  const worst = worstOf(chain);
  return html`<div class="chain" role="group" aria-label=${t.title}>
    <ol>${chain.map(([name, ok, count]) => html`<li class=${ok === null ? "unknown" : ok ? "ok" : "bad"}>
      <span class="dot" aria-hidden="true"></span>${t[name]}${count && html`<span class="count">${count}</span>`}<span class="sr"> ${ok === null ? t.unknown : ok ? t.ok : t.bad}</span>
    </li>`)}</ol>
    <p class=${worst ? "worst" : "dim"}>${worst ?? (chain.some(([, ok]) => ok === null) ? t.starting : t.allUp)}</p>
  </div>`;
}

function Clock() {
  clock.value;
  const live = isLive();
  const shown = live ? nowMs() : (state.value?.now_ns ?? 0) / 1e6;
  return html`<p class="clock ${live && !paused.value ? "" : "stopped"}"><span class="dim">${words.utc}</span> <time>${shown ? timeOfDay(shown) : "--:--:--"}</time>${paused.value ? html`<strong class="paused-badge">${words.pausedBadge}</strong>` : !live && html`<span class="note">${words.utcStopped}</span>`}</p>`;
}

function Header({ onHelp }) {
  const next = THEMES[(THEMES.indexOf(settings.value.theme) + 1) % THEMES.length];
  return html`<header class="top">
    <p class="who"><span class="dim">${words.unit}</span> ${state.value?.vehicle ?? ""}</p>
    <${Origin} />${!watch() && html`<${Watched} /><${Chain} />`}<${Clock} />
    <div class="tools">
      ${state.value && pagesHere().includes("settings") && html`<a class="ghost icon-only to-settings" href="#/settings" aria-label=${words.pages.settings} title=${words.pages.settings}><${Icon} name="settings" /></a>`}
      ${session.value?.session && html`<button class="ghost icon-only" onClick=${logOut} aria-label=${words.logOut(session.value.name)} title=${words.logOut(session.value.name)}><${Icon} name="logOut" /></button>`}
      <button class="ghost icon-only" onClick=${() => remember({ theme: next })} aria-label=${words.themeButton(words.theme[settings.value.theme])} title=${words.theme[settings.value.theme]}><${Icon} name="sun" /></button>
      <button class="ghost icon-only" onClick=${onHelp} aria-label=${words.help} title=${words.help}><${Icon} name="help" /></button>
    </div>
  </header>`;
}

function Banner({ onWhy }) {
  clock.value;
  const v = verdict();
  const since = v.since_ns && nowMs() ? duration(Math.max(0, (nowMs() - v.since_ns / 1e6) / 1000)) : null;
  const alarming = ["unsafe", "above_limit"].includes(v.state);
  const spoken = useRef({ key: "", text: "", alarm: "" });
  // Read aloud when the state or the row that decided changes, not with every number in the sentence.
  const key = `${v.state} ${v.row}`;
  if (spoken.current.key !== key) {
    const text = `${v.word}. ${v.sentence}`;
    spoken.current = { key, text, alarm: alarming ? text : "" };
  }
  useEffect(() => {
    document.title = `${v.word} - ${state.value?.vehicle ?? ""} - OBU`;
  }, [v.word, state.value?.vehicle]);
  return html`<section class="banner ${v.state}" aria-label=${words.banner.label}>
    <${Icon} name=${v.state} />
    <p class="word">${v.word}</p>
    <p class="sentence"><span lang=${v.language ?? "en"}>${v.sentence}</span>${since && html`<span class="since"> ${words.banner.since(since)}</span>`}</p>
    ${state.value && html`<button class="why" onClick=${onWhy}>${words.banner.why}<${Icon} name="next" /></button>`}
    <p class="sr" role="status">${alarming ? "" : spoken.current.text}</p>
    <p class="sr" role="alert">${spoken.current.alarm}</p>
  </section>`;
}

function WhyDrawer({ onClose }) {
  clock.value;
  const { banner } = state.value;
  const v = verdict();
  const report = () => copyText([`${v.word}: ${v.sentence}`, ...checksNow(banner).map((c) => `- ${c.label}: ${words.check[c.state]}, ${c.text}`)].join("\n"));
  return html`<${Drawer} title=${words.banner.drawer(v.word)} onClose=${onClose} head=${html`<button onClick=${report}>${words.copyReport}</button>`}>
    <p class="lead-text" lang=${v.language ?? "en"}>${v.sentence}</p>
    ${v.action && html`<h3>${words.banner.action}</h3><p lang=${v.language ?? "en"}>${v.action}</p>`}
    ${v.reasons?.length > 0 && html`<h3>${words.banner.reasons}</h3><ul class="reasons">${v.reasons.map((reason) => html`<li key=${reason}>${reason}</li>`)}</ul>`}
    <h3>${words.banner.checks}</h3>
    ${role() === "obu" && html`<p class="note block"><a href="#/trust" onClick=${onClose}>${words.banner.page}</a></p>`}
    ${checksNow(banner).some((c) => c.ratio !== null) && html`<p class="note block">${words.banner.meter}</p>`}
    <ul class="checks long">${checksNow(banner).map((c) => html`<li>
      <${StateIcon} state=${c.state} word=${words.check[c.state]} />
      <span>${c.link ? html`<a href=${`#/${c.link}`} onClick=${onClose} title=${words.banner.look(c.label)}>${c.label}</a>` : c.label}</span>
      <span class="dim">${c.state === "off" ? `${words.check.off}: ${c.text}` : c.text}</span>
      ${c.ratio !== null && html`<span class="meter" aria-hidden="true"><span class=${c.state} style=${{ width: `${Math.min(c.ratio / 2, 1) * 100}%` }}></span></span>`}
    </li>`)}</ul>
  </${Drawer}>`;
}

function LostBar() {
  clock.value;
  const { lostAt, why, gap, open } = link.value;
  const lostS = lostAt === null ? 0 : (performance.now() - lostAt) / 1000;
  const [shownGap, setShownGap] = useState(null);
  useEffect(() => {
    if (!open || gap === null || gap < 1) return undefined;
    setShownGap(gap);
    const timer = setTimeout(() => setShownGap(null), 6000);
    return () => clearTimeout(timer);
  }, [open, gap]);
  const full = why === "full";
  const visible = !open && lostS > LOST_BAR_AFTER_S && (state.value || !full); // without any data the page says it
  const reason = full ? words.lost.full(link.value.viewers.connected) : watch() ? "" : words.lost.why[why] ?? ""; // of a unit that is not asked
  return html`<section class="notices" aria-label=${words.notices}>${visible && html`<div class="bar lost"><${Icon} name="stale" /><p>${!state.value ? words.lost.never : (watch() ? words.watch : words.lost).bar(duration(lostS))} <span>${reason}</span></p></div>`}
    ${outdated.value && html`<div class="bar"><p>${words.lost.outdated}</p><button onClick=${() => location.reload()}>${words.lost.reload}</button></div>`}
    ${paused.value && html`<div class="bar paused"><p>${words.paused(timeOfDay(nowMs()))}</p><button onClick=${togglePause}>${words.resume}</button></div>`}
    <p class=${shownGap === null ? "sr" : "bar back"} role="status">${shownGap === null ? "" : words.lost.back(duration(shownGap))}</p></section>`;
}

// The bar of a replay is loaded with the first frame of one.
function Replay() {
  const [Bar, setBar] = useState(null);
  const replay = Boolean(state.value?.replay);
  useEffect(() => {
    if (replay && !Bar) import("./recordings/replay.js").then((m) => setBar(() => m.ReplayBar), () => {}); // or when the connection is back
  }, [replay, link.value.open]);
  return replay && Bar ? html`<${Bar} />` : null;
}

function Navigation({ page }) {
  const problems = state.value?.problems.length ?? 0;
  return html`<nav class="pages" aria-label=${words.navigation}><ul>
    ${pagesHere().map((name) => html`<li class=${name}><a href=${`#/${name}`} aria-current=${page === name ? "page" : null}>
      <${Icon} name=${name} />${words.pages[name]}${name === "system" && problems > 0 && html`<span class="badge">${problems}</span>`}</a></li>`)}
  </ul></nav>`;
}

function Footer() {
  if (!state.value) return null;
  const t = words.footer;
  const { bus, chain, recording, problems } = state.value;
  const toCome = chain.services.of - chain.services.up;
  const first = problems[0];
  const target = first && (first.what.includes("/") ? `topic=${first.what}` : contract.value.processes[first.what] ? `node=${first.what}` : "");
  const live = brokerAnswers();
  const v = verdict();
  const received = recording && !isOld("recording/state", recording.updated_ns);
  if (watch()) return null; // of the unit as a whole nothing is passed on
  return html`<footer class="foot" aria-label=${t.label}>
    ${live && html`<span>${t.rate(rate(bus.messages_hz))}</span>
    ${bus.delay_p95_s != null && html`<span>${t.delay(seconds(bus.delay_p95_s))}</span>`}
    ${bus.memory_bytes > 0 && html`<span class="wide-only">${t.load(`${Math.round(bus.cpu_share * 100)} %`, bytes(bus.memory_bytes))}</span>`}
    ${received && html`<span>${t.disk(bytes(recording.free_bytes))}</span>`}
    <span class=${received && recording.recording ? "rec" : ""}>${!received ? t.recordingUnknown : recording.recording ? t.recording(bytes(recording.bytes_written)) : t.notRecording}</span>`}
    ${v.state !== "safe" && html`<a class="problems verdict-state" href=${role() === "rsu" ? "#/toll" : "#/trust"}><${StateIcon} state=${v.state} word="" />${v.word}</a>`}
    ${first ? html`<a class="problems" href=${`#/system?${target}`}><${Icon} name="caution" />${t.problems(problems.length, told(first, first.text), first.since_ns && nowMs() ? duration(Math.max(0, (nowMs() - first.since_ns / 1e6) / 1000)) : null)}</a>`
      : html`<span class=${v.state === "safe" ? "push dim" : "dim"}>${!live ? words.status.unknown : toCome > 0 ? t.toCome(toCome) : t.noProblems}</span>`}
  </footer>`;
}

function HelpDrawer({ onClose }) {
  const t = words.shortcuts;
  return html`<${Drawer} title=${t.title} onClose=${onClose}>
    <p class="lead-text">${t.intro}</p>
    <label class="switch"><input type="checkbox" checked=${settings.value.shortcuts} onChange=${(e) => remember({ shortcuts: e.target.checked })} /> ${t.enabled}</label>
    <div class="toolbar units"><label>${t.speeds} <select value=${speedUnit()} onChange=${(e) => remember({ speed: e.target.value })}>${Object.keys(words.speed.unitNames).map((unit) => html`<option value=${unit}>${unit}</option>`)}</select></label>
      <label>${t.lengths} <select value=${lengthUnit()[0]} onChange=${(e) => remember({ length: e.target.value })}>${Object.keys(words.lengthNames).map((unit) => html`<option value=${unit}>${unit}</option>`)}</select></label>
      <label>${t.times} <select value=${settings.value.clock ?? "utc"} onChange=${(e) => remember({ clock: e.target.value })}>${Object.entries(t.clocks).map(([name, text]) => html`<option value=${name}>${text}</option>`)}</select></label></div>
    <p class="note">${t.unitsNote}</p>
    <dl class="keys">${t.rows.map(([key, what]) => html`<div><dt>${key.split(" ").map((k) => html`<kbd>${k}</kbd> `)}</dt><dd>${what}</dd></div>`)}</dl>
    <h3>${t.states}</h3>
    <ul class="checks long">${Object.entries(t.stateNotes).map(([s, note]) => html`<li><${StateIcon} state=${s} word="" /><span>${words.trust[s]}</span><span class="dim">${note}</span></li>`)}</ul>
    <p class="links"><a href="docs">${t.api}</a><a href="asyncapi.json">${t.topics}</a><a href="metrics">${t.metrics}</a></p>
  </${Drawer}>`;
}

function useKeys(open) {
  useLayoutEffect(() => { // no key is lost between the first picture and the effects after it
    let before = "";
    const pressed = (event) => {
      const typing = /^(INPUT|SELECT|TEXTAREA)$/.test(event.target.tagName);
      if (!settings.value.shortcuts || typing || event.ctrlKey || event.altKey || event.metaKey) return;
      const key = event.key;
      if (before === "g" && pagesHere().includes(GO[key])) go(`#/${GO[key]}`);
      else if (key === "?") open("help");
      else if (key === "w" && state.value) open("why");
      else if (key === "p") togglePause();
      else if (key === "/" && pagesHere().includes("system")) {
        event.preventDefault();
        go("#/system?find="); // the page itself takes the focus, once it is there
      }
      before = key;
    };
    addEventListener("keydown", pressed);
    return () => removeEventListener("keydown", pressed);
  }, []);
}

function App() {
  const { page, query } = useRoute();
  const [drawer, setDrawer] = useState(null);
  const [, redraw] = useState(0);
  const [tries, setTries] = useState(0);
  const heading = useRef(null);
  // The event of a dialog that was closed may come after another one was opened.
  const closed = (name) => () => setDrawer((shown) => (shown === name ? null : shown));
  useKeys(setDrawer);
  useEffect(() => {
    document.documentElement.dataset.theme = settings.value.theme;
  }, [settings.value.theme]);
  useEffect(() => {
    if (loaded[page]) return undefined;
    let again = null;
    LATER[page]().then(
      (component) => (loaded[page] = component),
      (error) => {
        // What cannot be fetched is tried again; a program that fails is an error of its page.
        if (error instanceof TypeError && /fetch|import/i.test(error.message)) again = setTimeout(() => setTries((n) => n + 1), TRY_AGAIN_MS);
        else loaded[page] = () => { throw error; };
      },
    ).then(() => redraw((n) => n + 1));
    return () => clearTimeout(again);
  }, [page, link.value.open, tries]);
  const ready = state.value && contract.value;
  const { why, viewers, open } = link.value;
  const full = !state.value && !open && why === "full";
  const shown = full ? html`<${Empty} title=${words.lost.full(viewers.connected)} why=${words.lost.fullWhy(viewers.maximum)} what=${html`<button onClick=${() => location.reload()}>${words.lost.again}</button>`} />`
    : !ready ? html`<p class="boot">${words.connecting}</p>`
    : loaded[page] ? html`<${loaded[page]} query=${query} go=${go} onWhy=${() => setDrawer("why")} />`
    : link.value.open && !tries ? null : html`<${Empty} title=${words.lost.page} why=${words.lost.pageWhy} />`;
  return html`<a class="skip" href="#content" onClick=${(e) => { e.preventDefault(); heading.current.focus(); }}>${words.skip}</a>
    <${Guard}><${Header} onHelp=${() => setDrawer("help")} /></${Guard}>
    <${Guard}><${Banner} onWhy=${() => setDrawer("why")} /></${Guard}>
    <${Guard}><${Replay} /><${LostBar} /></${Guard}>
    <div class="body"><${Guard}><${Navigation} page=${page} /></${Guard}>
      <main id="content" class=${connected() || !ready ? "" : "disconnected"}><h1 class="sr" ref=${heading} tabindex="-1">${words.pages[page]}</h1><${Guard} key=${page}>${shown}</${Guard}></main></div>
    <${Guard}><${Footer} /></${Guard}>
    <${Guard} key=${drawer}>${drawer === "why" && ready && html`<${WhyDrawer} onClose=${closed("why")} />`}
    ${drawer === "help" && html`<${HelpDrawer} onClose=${closed("help")} />`}</${Guard}>`;
}

const root = document.getElementById("app");
root.replaceChildren();
tellErrors();
render(html`<${Guard}><${App} /></${Guard}>`, root);
start();
renew().catch(() => {}); // without an answer the connection is lost, which the page says
