// The page Map: the track of this drive on a map that needs no internet.
import { useEffect, useRef, useState } from "preact/hooks";
import { clock, link, paused, remember, settings, state } from "../store.js";
import { Age, Card, Empty, Icon, duration, html, metres, timeOfDay } from "../parts.js";
import { CloseUp, SYMBOLS, items, scene } from "../closeup.js";
import { words } from "../words.js";
import { between, moved } from "./geodesy.js";
import { hypothesesNow, useReport } from "../trust/hypotheses.js";
import { COLOUR_KEYS, LAYERS, LEVELS_M, alternatives, collection, roads, sections } from "./layers.js";
import { alternativeStyle, drawable, trackColours } from "./style.js";
import { hasGraphics, loadArchiveReader, loadLibrary } from "./library.js";
import { MapView, STREET_ZOOM, boundsOf } from "./view.js";
import { w } from "./map_words.js";

const POLL_MS = 1000;
const HIDDEN = "hidden map layers";
const ALTERNATIVES = "map alternatives"; // shown or not as somebody chose; without a choice they are while a hypothesis is suspected

let track = null; // the answer of /api/track, with the rows that came since
let lastCamera = null;

async function ask(path) {
  const answer = await fetch(path);
  if (!answer.ok) throw new Error(`${path}: ${answer.status}`);
  return answer.json();
}

async function renewTrack() {
  const after = track?.columns.time_ns.at(-1) ?? 0;
  const answer = await ask(`api/track?generation=${track?.generation ?? -1}&after_ns=${after}`);
  if (!answer.complete) {
    for (const [name, values] of Object.entries(track.columns)) values.push(...answer.columns[name]);
    answer.columns = track.columns;
  }
  track = answer;
  return answer.complete;
}

function useTheme() {
  const [dark, setDark] = useState(matchMedia("(prefers-color-scheme: dark)").matches);
  useEffect(() => {
    const query = matchMedia("(prefers-color-scheme: dark)");
    const changed = () => setDark(query.matches);
    query.addEventListener("change", changed);
    return () => query.removeEventListener("change", changed);
  }, []);
  const chosen = settings.value.theme;
  return chosen === "auto" ? (dark ? "dark" : "light") : chosen;
}

// Where everything is now; the offsets of GNSS and truth are those that the close-up view draws.
function placesNow() {
  const sc = scene();
  if (!sc) return { sc: null, place: null, gnss: null, truth: null };
  const place = [sc.s.longitude_deg, sc.s.latitude_deg];
  const offset = (p) => p && moved(place, p.north, p.east);
  return { sc, place, gnss: offset(sc.gnss), truth: offset(sc.truth) };
}

const received = (topic) => state.value?.topics[topic]?.updated_ns != null;

function useHidden() {
  const [hidden, setHidden] = useState(settings.value[HIDDEN] ?? []);
  const toggle = (id) => {
    const next = hidden.includes(id) ? hidden.filter((other) => other !== id) : [...hidden, id];
    setHidden(next);
    remember({ [HIDDEN]: next });
  };
  return [hidden, toggle];
}

const suspected = (hypothesis) => Boolean(state.value.trust.hypotheses[hypothesis]?.suspected);

// Whether the alternatives are drawn, what switches them, and their tracks while they are.
function useAlternatives() {
  const chosen = settings.value[ALTERNATIVES] ?? null;
  const rows = hypothesesNow();
  const known = rows.some(([, row]) => row.solutions > 0);
  const shown = known && (chosen ?? rows.some(([name]) => suspected(name)));
  const report = useReport(shown);
  return { known, shown, report, toggle: () => remember({ [ALTERNATIVES]: !shown }) };
}

// Everything that the page asks the unit for, beside the stream.
function useAnswers() {
  const [installed, setInstalled] = useState(null);
  const [network, setNetwork] = useState(null);
  const [, redraw] = useState(0);
  const afresh = useRef(true);
  const connected = link.value.open;
  useEffect(() => {
    if (connected && !installed) ask("api/map").then(setInstalled, () => {});
  }, [connected, installed]);
  const simulated = received("simulation/roads");
  useEffect(() => {
    if (simulated) ask("api/topics/simulation/roads").then((answer) => setNetwork(answer.message), () => {});
  }, [simulated]);
  useEffect(() => {
    let asking = false;
    const poll = () => {
      if (asking || !link.value.open || (paused.value && track)) return;
      asking = true;
      renewTrack().then((all) => {
        afresh.current ||= all;
        redraw((n) => n + 1);
      }, () => {}).finally(() => { asking = false; }); // asked again in a second
    };
    poll();
    const timer = setInterval(poll, POLL_MS);
    return () => clearInterval(timer);
  }, []);
  return { installed, network, afresh };
}

function Swatch({ colour, kind = "aided" }) {
  const dash = { aided: null, dead: "6 4", gap: "2 5" }[kind];
  return html`<svg width="26" height="12" aria-hidden="true"><path d="M1 6h24" fill="none" stroke=${colour} stroke-width="4" stroke-dasharray=${dash} /></svg>`;
}

function AlternativeKey({ theme, hypothesis }) {
  const { colour, dash } = alternativeStyle(theme, hypothesis);
  return html`<svg width="34" height="12" aria-hidden="true"><path d="M1 6h32" fill="none" stroke=${colour} stroke-width="2.5" stroke-dasharray=${dash.map((part) => 2.5 * part).join(" ")} /></svg>`;
}

function Legend({ colourBy, theme, sc, columns, tracks }) {
  const named = new Map(tracks.map((t) => [t.hypothesis, t.label]));
  const colours = trackColours(theme);
  const states = [...new Set(columns?.state ?? [])];
  const classes = [...LEVELS_M, null].map((to, i) => [`level${i}`, w.levels(LEVELS_M[i - 1], to)]);
  const keys = colourBy === "trust" ? states.map((s) => [s, words.trust[s] ?? s]) : [...classes, ["none", w.noLevel]];
  return html`<ul class="legend map-legend">
    ${keys.map(([key, label]) => html`<li><${Swatch} colour=${colours[key] ?? colours.none} /><span>${label}</span></li>`)}
    ${Object.entries(w.kinds).map(([kind, label]) => html`<li><${Swatch} colour="var(--text)" kind=${kind} /><span>${label}</span></li>`)}
    ${sc && items(sc).map(([key, name, value]) => html`<li><svg width="18" height="18" aria-hidden="true">${SYMBOLS[key]}</svg><span>${name}</span><span class="dim">${key === "fused" ? "" : value}</span></li>`)}
    ${[...named].map(([hypothesis, label]) => html`<li key=${hypothesis}><${AlternativeKey} theme=${theme} hypothesis=${hypothesis} /><span>${w.alternative(label, suspected(hypothesis))}</span></li>`)}
  </ul>`;
}

function Sections({ columns }) {
  const rows = columns ? sections(columns).reverse() : [];
  if (!rows.length) return html`<p class="note block">${w.noTrack}</p>`;
  return html`<div class="scroll" tabindex="0" role="group" aria-label=${w.table}><table class="plain"><thead><tr>${w.columns.map((c) => html`<th scope="col">${c}</th>`)}</tr></thead>
    <tbody>${rows.map((r) => html`<tr><th scope="row">${timeOfDay(r.from / 1e6)}</th><td>${duration((r.to - r.from) / 1e9)}</td><td>${words.trust[r.state] ?? r.state}</td><td>${w.kinds[r.kind]}</td><td>${r.level ? metres(r.level) : words.age.bar}</td></tr>`)}</tbody></table></div>`;
}

function Layers({ ids, hidden, toggle }) {
  return html`<details class="map-layers"><summary>${w.layers}</summary><fieldset><legend class="sr">${w.layers}</legend>
    ${ids.map((id) => html`<label class="switch"><input type="checkbox" checked=${!hidden.includes(id)} onChange=${() => toggle(id)} /> ${w.layer[id]}</label>`)}
  </fieldset></details>`;
}

// The layers that plug in by topic: asked for once a second while they are shown.
function useOverlay(view, ids) {
  const key = ids.join();
  useEffect(() => {
    if (!view) return undefined;
    const poll = async () => {
      if (!link.value.open || paused.value) return;
      const parts = await Promise.all(LAYERS.filter((layer) => ids.includes(layer.id)).map((layer) =>
        ask(`api/topics/${layer.topic}`).then((answer) => (answer.message && answer.freshness !== "stale" ? layer.draw(answer.message) : []), () => [])));
      const features = parts.flat();
      view.set("overlay", collection(features));
      if (!placesNow().place) view.placeOnce(features.find((f) => f.properties.role === "plaza")?.geometry.coordinates);
    };
    poll();
    const timer = setInterval(poll, POLL_MS);
    return () => clearInterval(timer);
  }, [view, key]);
}

function firstCamera(place, network) {
  if (lastCamera) return lastCamera;
  if (place) return { center: place, zoom: STREET_ZOOM };
  const road = network?.roads[0];
  if (road) return { center: [road.longitude_deg[0], road.latitude_deg[0]], zoom: 14 };
  return { center: [0, 20], zoom: 1 };
}

function Picture({ installed, network, afresh, theme, hidden, ids, report, colourBy, onView, handlers }) {
  const box = useRef(null);
  const [view, setView] = useState(null);
  const now = placesNow();
  const description = installed.map && drawable(installed.map) ? installed.map : null;
  useEffect(() => {
    let made = null;
    let gone = false;
    loadLibrary().then(async (found) => {
      if (description?.container === "pmtiles") await loadArchiveReader(found);
      if (gone) return;
      const start = firstCamera(now.place, network);
      made = new MapView(found, box.current, { theme, title: w.canvas, description, camera: start, placed: Boolean(lastCamera || now.place), latitude: start.center[1], handlers });
      await made.ready;
      if (gone) return;
      afresh.current = true;
      setView(made);
      onView(made);
    }).catch(handlers.failedToLoad);
    return () => {
      gone = true;
      if (made) {
        lastCamera = made.camera();
        made.remove();
      }
      setView(null);
      onView(null);
    };
  }, [theme, description]);
  useEffect(() => view?.set("roads", roads(network)), [view, network]);
  useEffect(() => {
    if (!view) return;
    view.show(["base", "roads"], !hidden.includes("base"));
    view.show(["graticule"], !hidden.includes("grid"));
    for (const id of ["gnss", "truth", "uncertainty"]) view.show([id], !hidden.includes(id));
  }, [view, hidden]);
  useEffect(() => view?.set("alternatives", report ? alternatives(report.tracks, suspected, report.now_ns) : collection()), [view, report]);
  const shown = useRef(colourBy);
  useEffect(() => {
    if (!view || !track) return;
    view.drawTrack(track.columns, COLOUR_KEYS[colourBy], afresh.current || shown.current !== colourBy);
    afresh.current = false;
    shown.current = colourBy;
  }, [view, track, colourBy]);
  useEffect(() => {
    if (!view) return;
    view.drawNow(now.place, now.sc, { gnss: hidden.includes("gnss") ? null : now.gnss, truth: hidden.includes("truth") ? null : now.truth });
    if (now.place) handlers.placed(now.place, (now.sc.s.heading_rad * 180) / Math.PI);
  });
  useOverlay(view, ids.filter((id) => !hidden.includes(id)));
  return html`<div class="map-box" ref=${box}></div>${!view && html`<p class="map-wait">${w.loading}</p>`}`;
}

export function MapPage() {
  clock.value;
  const theme = useTheme();
  const { installed, network, afresh } = useAnswers();
  const [hidden, toggleHidden] = useHidden();
  const alternative = useAlternatives();
  const [follow, setFollow] = useState(true);
  const [colourBy, setColourBy] = useState("trust");
  const [table, setTable] = useState(false);
  const [ends, setEnds] = useState(null); // of the measured line; null: not measuring
  const [message, setMessage] = useState(w.hint);
  const [missing, setMissing] = useState(() => (hasGraphics() ? null : w.noGraphics));
  const view = useRef(null);
  const [ready, setReady] = useState(false); // until the map is drawn its buttons have nothing to act on
  const live = useRef({});
  const headingUp = settings.value.headingUp;
  live.current = { follow, headingUp, ends };
  const { sc, place } = placesNow();

  const mark = (point) => {
    const next = live.current.ends.length === 2 ? [point] : [...live.current.ends, point];
    setEnds(next);
    view.current.drawMeasure(next);
    const measured = next.length === 2 ? between(...next) : null;
    setMessage(measured ? w.measured(metres(measured.metres), `${measured.degrees.toFixed(1).padStart(5, "0")}°`) : w.measureSecond);
  };
  const inspect = (pixel) => {
    const i = track ? view.current.nearest(track.columns, pixel) : -1;
    if (i < 0) return;
    const c = track.columns;
    setMessage(w.inspect(timeOfDay(c.time_ns[i] / 1e6), words.trust[c.state[i]] ?? c.state[i], w.kinds[c.aided[i] ? "aided" : "dead"].toLowerCase(), c.level_m[i] == null ? null : metres(c.level_m[i])));
  };
  const handlers = useRef(null);
  handlers.current ??= {
    dragged: () => setFollow(false),
    rotated: () => remember({ headingUp: false }),
    clicked: (point, pixel) => (handlers.current.latest.measuring() ? handlers.current.latest.mark(point) : handlers.current.latest.inspect(pixel)),
    failed: (error) => console.warn(`map: ${error?.message ?? error}`),
    failedToLoad: () => setMissing(w.noLibrary),
    placed: (p, heading) => live.current.follow && view.current?.follow(p, live.current.headingUp ? heading : 0),
  };
  handlers.current.latest = { mark, inspect, measuring: () => live.current.ends !== null };

  const shown = (v) => {
    view.current = v;
    setReady(v !== null);
    v?.drawMeasure(live.current.ends ?? []);
  };
  const startMeasure = () => {
    const begin = ends === null;
    setEnds(begin ? [] : null);
    view.current.drawMeasure([]);
    setMessage(begin ? w.measureFirst : w.hint);
  };
  const whole = () => {
    const bounds = boundsOf(track?.columns);
    if (!bounds) return;
    setFollow(false);
    view.current.fit(bounds);
  };
  const turn = () => {
    remember({ headingUp: !headingUp });
    if (!follow && headingUp) view.current?.follow(view.current.centre(), 0);
  };

  if (missing) return html`<div class="page map-page"><p class="note block" role="status">${missing}</p><${CloseUp} /></div>`;
  const topics = LAYERS.filter((layer) => received(layer.topic)).map((layer) => layer.id);
  const ids = ["base", "grid", "gnss", ...(received("truth/state") ? ["truth"] : []), "uncertainty", ...(alternative.known ? ["alternatives"] : []), ...topics];
  const off = alternative.shown ? hidden : [...hidden, "alternatives"];
  const toggle = (id) => (id === "alternatives" ? alternative.toggle() : toggleHidden(id));
  const first = track?.started_ns;
  const summary = first ? w.summary(metres(track.length_m), duration((track.now_ns - first) / 1e9)) : w.noTrack;
  const grid = installed && !installed.map && !network ? w.noMap : installed?.map && !drawable(installed.map) ? w.schema : null;
  const credit = installed?.map?.attribution || (network ? w.roads : "");
  const said = [summary, ...(sc ? items(sc).map(([, name, value]) => `${name}: ${value}`) : [])].join(". ");
  return html`<div class="page map-page"><${Card} title=${w.title} note=${first ? summary : null} id="map" class="map-card" aside=${sc && html`<${Age} topic="navigation/solution" stamp=${sc.s.updated_ns} />`}>
    <div class="toolbar map-tools">
      <button onClick=${() => view.current.zoomBy(1)} disabled=${!ready} aria-label=${w.zoomIn} class="icon-only"><${Icon} name="plus" /></button>
      <button onClick=${() => view.current.zoomBy(-1)} disabled=${!ready} aria-label=${w.zoomOut} class="icon-only"><${Icon} name="minus" /></button>
      <button onClick=${() => setFollow(!follow)} aria-pressed=${follow} title=${w.followTitle}>${w.follow}</button>
      <button onClick=${turn} aria-pressed=${headingUp}>${w.headingUp}</button>
      <button onClick=${whole} disabled=${!ready || !first}>${w.whole}</button>
      <button onClick=${startMeasure} disabled=${!ready} aria-pressed=${ends !== null}>${w.measure}</button>
      ${ends !== null && html`<button onClick=${() => mark(view.current.centre())} disabled=${!ready}>${w.mark}</button>`}
      <span class="map-colour"><span class="dim" aria-hidden="true">${w.colour}</span> <select aria-label=${w.colour} value=${colourBy} onChange=${(e) => setColourBy(e.target.value)}>${Object.entries(w.colours).map(([key, label]) => html`<option value=${key}>${label}</option>`)}</select></span>
      <${Layers} ids=${ids} hidden=${off} toggle=${toggle} />
      <button onClick=${() => setTable(!table)} aria-pressed=${table} class="push">${table ? w.picture : w.table}</button>
    </div>
    <div class="stage map-stage ${ends !== null ? "measuring" : ""}">
      <div class="map-hold" hidden=${table} role="group" aria-label=${w.label(said)}>
        ${installed && html`<${Picture} installed=${installed} network=${network} afresh=${afresh} theme=${theme} hidden=${hidden} ids=${topics} report=${alternative.report} colourBy=${colourBy}
          onView=${shown} handlers=${handlers.current} />`}
        ${!place && !state.value.toll && html`<p class="map-note">${w.noPosition}</p>`}
      </div>
      ${table && html`<${Sections} columns=${track?.columns} />`}
    </div>
    <p class="note map-message" role="status">${message}</p>
    ${[installed?.problem, grid].filter(Boolean).map((sentence) => html`<p class="note block">${sentence}</p>`)}
    <${Legend} colourBy=${colourBy} theme=${theme} sc=${sc} columns=${track?.columns} tracks=${alternative.report?.tracks ?? []} />
    <p class="note map-foot"><span>${w.download} <a href="api/track.gpx" download>${w.gpx}</a> <a href="api/track.kml" download>${w.kml}</a> ${first ? w.thinned(metres(track.spacing_m)) : ""}</span>${credit && html`<span class="push">${credit}</span>`}</p>
  </${Card}></div>`;
}
