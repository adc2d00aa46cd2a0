// The page Map: all vehicles on a map and in a list, counts by verdict, filter, and the chosen one with its track.
import { useEffect, useMemo, useRef, useState } from "preact/hooks";
import { settings } from "./unit/store.js";
import { Card, Empty, Icon, StateIcon, html } from "./unit/parts.js";
import { hasGraphics, loadArchiveReader, loadLibrary } from "./unit/map/library.js";
import { drawable } from "./unit/map/style.js";
import { VERDICTS, heard, may, newestOf, onFrame } from "./store.js";
import { Age, Problem, Verdict, useAsked, wordOf } from "./parts.js";
import { FleetView } from "./view.js";
import { w as all } from "./words.js";

const w = all.map;
const LIST_MS = 5000;
const FRESH_LIST_MS = 1000; // after changes
const VEHICLE_ZOOM = 16;
const CLUSTER_STEP = 2;
const OTHERWISE = { center: [0, 25], zoom: 1 };

let lastCamera = null;
let lastFilter = { find: "", verdicts: [], age: "any", alarm: false };

function queryOf({ find, verdicts, age, alarm }) {
  const query = new URLSearchParams();
  if (find.trim()) query.set("find", find.trim());
  if (verdicts.length) query.set("verdicts", verdicts.join());
  if (age !== "any") query.set("age", age);
  if (alarm) query.set("alarm", "true");
  const text = query.toString();
  return text ? `?${text}` : "";
}

function useDark() {
  const query = useMemo(() => matchMedia("(prefers-color-scheme: dark)"), []);
  const [dark, setDark] = useState(query.matches);
  useEffect(() => {
    const changed = () => setDark(query.matches);
    query.addEventListener("change", changed);
    return () => query.removeEventListener("change", changed);
  }, []);
  const chosen = settings.value.theme;
  return chosen === "auto" ? (dark ? "dark" : "light") : chosen;
}

function Counts({ counts, filter, setFilter }) {
  const fresh = VERDICTS.map((_, code) => counts.filter((c) => c.verdict === code && !c.old).reduce((n, c) => n + c.vehicles, 0));
  const old = counts.filter((c) => c.old).reduce((n, c) => n + c.vehicles, 0);
  const toggle = (code) => {
    const verdicts = filter.verdicts.includes(code) ? filter.verdicts.filter((c) => c !== code) : [...filter.verdicts, code].sort();
    setFilter({ ...filter, verdicts });
  };
  return html`<div class="toolbar counts" role="group" aria-label=${w.counts}>
    ${VERDICTS.map((name, code) => html`<button key=${name} aria-pressed=${filter.verdicts.includes(code)} onClick=${() => toggle(code)}><${StateIcon} state=${name} word="" /> <strong>${fresh[code]}</strong> ${wordOf(code)}</button>`)}
    <button aria-pressed=${filter.age === "old"} title=${w.oldTitle} onClick=${() => setFilter({ ...filter, age: filter.age === "old" ? "any" : "old" })}><${StateIcon} state="stale" word="" /> <strong>${old}</strong> ${w.old}</button>
  </div>`;
}

function Filter({ filter, setFilter }) {
  const active = queryOf(filter) !== "";
  return html`<div class="toolbar filter">
    <input type="search" aria-label=${w.find} placeholder=${w.find} maxlength="48" value=${filter.find} onInput=${(e) => setFilter({ ...filter, find: e.target.value })} />
    <select aria-label=${w.age} value=${filter.age} onChange=${(e) => setFilter({ ...filter, age: e.target.value })}>${Object.entries(w.ages).map(([key, text]) => html`<option key=${key} value=${key}>${text}</option>`)}</select>
    <label class="switch"><input type="checkbox" checked=${filter.alarm} onChange=${(e) => setFilter({ ...filter, alarm: e.target.checked })} /> ${w.alarm}</label>
    ${active && html`<button class="link" onClick=${() => setFilter({ find: "", verdicts: [], age: "any", alarm: false })}>${w.clear}</button>`}
  </div>`;
}

const speedOf = (row) => (row.north_m_s == null ? all.unknown : `${Math.round(Math.hypot(row.north_m_s, row.east_m_s) * 3.6)} km/h`);

function List({ answer, chosen, onChoose }) {
  if (!answer.vehicles.length) {
    return answer.counts.length ? html`<${Empty} title=${w.none} why=${w.noneWhy} />` : html`<${Empty} title=${w.empty} why=${may("admin") ? w.emptyWhy : w.emptyWhyOthers} />`;
  }
  return html`<div class="scroll fleet-list" tabindex="0" role="group" aria-label=${w.list}><table class="plain">
    <thead><tr>${w.columns.map((text) => html`<th key=${text} scope="col">${text}</th>`)}</tr></thead>
    <tbody>${answer.vehicles.map((row) => html`<tr key=${row.vehicle} class=${chosen === row.vehicle ? "chosen" : ""}>
      <th scope="row"><button class="link" aria-pressed=${chosen === row.vehicle} onClick=${() => onChoose(row)}>${row.vehicle}</button>
        ${row.alarms.length > 0 && html`<span class="alarm-mark" title=${row.alarms.map((kind) => w.alarms[kind]).join(", ")}><${StateIcon} state="caution" word=${row.alarms.map((kind) => w.alarms[kind]).join(", ")} /></span>`}</th>
      <td><${Verdict} code=${row.verdict} ms=${row.utc_ms} /></td><td><${Age} ms=${row.utc_ms} /></td>
      <td class="number">${row.latitude_deg == null ? w.noPosition : speedOf(row)}</td></tr>`)}</tbody></table>
    ${answer.more && html`<p class="note block">${w.more(answer.vehicles.length)}</p>`}</div>`;
}

function Chosen({ name, row, onCentre, onClose }) {
  return html`<section class="chosen-vehicle" aria-label=${name}><p><strong>${name}</strong> ${row && html`<${Verdict} code=${row.verdict} ms=${row.utc_ms} /> <${Age} ms=${row.utc_ms} />`}</p>
    <div class="toolbar"><a class="button" href=${`#/vehicles/${encodeURIComponent(name)}`}>${w.open}</a>
      <button onClick=${onCentre} disabled=${row?.latitude_deg == null}>${w.centre}</button>
      <button class="ghost icon-only push" onClick=${onClose} aria-label=${w.close}><${Icon} name="close" /></button></div>
    <p class="note">${w.trail}</p></section>`;
}

function Picture({ installed, extent, theme, query, onView, onChoose, onMissing }) {
  const box = useRef(null);
  const view = useRef(null);
  const [ready, setReady] = useState(false);
  const description = installed?.map && drawable(installed.map) ? installed.map : null;
  const handlers = useRef({
    dragged: () => {}, rotated: () => {},
    failed: (error) => console.warn(`map: ${error?.message ?? error}`),
    clicked: (_, pixel) => {
      const found = view.current.under(pixel);
      if (found?.vehicle) onChoose(found.vehicle);
      else if (found) view.current.look(found.cluster, view.current.map.getZoom() + CLUSTER_STEP);
    },
  });
  useEffect(() => {
    let gone = false;
    let made = null;
    loadLibrary().then(async (found) => {
      if (description?.container === "pmtiles") await loadArchiveReader(found);
      if (gone) return;
      const camera = lastCamera ?? (extent ? { bounds: [[extent.west, extent.south], [extent.east, extent.north]], fitBoundsOptions: { padding: 50, maxZoom: 15 } } : OTHERWISE);
      made = new FleetView(found, box.current, { theme, title: w.canvas, description, camera, placed: true, latitude: extent?.north ?? 0, query, handlers: handlers.current });
      view.current = made;
      await made.ready;
      if (gone) return;
      setReady(true);
      onView(made);
    }).catch(() => onMissing(w.noLibrary));
    return () => {
      gone = true;
      onView(null);
      setReady(false);
      if (made) {
        lastCamera = made.camera();
        made.remove();
      }
    };
  }, [theme, description]);
  useEffect(() => { if (ready) view.current.filter(query); }, [query, ready]);
  return html`<div class="map-box" ref=${box}></div>${!ready && html`<p class="map-wait">${w.loading}</p>`}`;
}

export function MapPage() {
  const theme = useDark();
  const [filter, setFilter] = useState(lastFilter);
  const [chosen, setChosen] = useState(null);
  const [missing, setMissing] = useState(() => (hasGraphics() ? null : w.noGraphics));
  const [said, setSaid] = useState("");
  const [view, setView] = useState(null);
  lastFilter = filter;
  const query = queryOf(filter);
  heard.value; // drawn again when verdicts change
  const { answer: listed, error, again, askedAt } = useAsked(`api/vehicles${query}`, LIST_MS);
  const installed = useAsked("api/map").answer;
  const trail = useAsked(chosen ? `api/vehicles/${encodeURIComponent(chosen)}/trail` : null, LIST_MS).answer;
  const asked = useAsked(chosen ? `api/vehicles/${encodeURIComponent(chosen)}` : null, LIST_MS);
  const one = asked.answer?.vehicle?.vehicle === chosen ? asked.answer.vehicle : null;
  if (one) newestOf(one, asked.askedAt); // before the list: both show the newer of the two
  const answer = useMemo(() => listed && { ...listed, vehicles: listed.vehicles.map((v) => newestOf(v, askedAt)) }, [listed, heard.value, one]);
  const found = one ?? answer?.vehicles.find((v) => v.vehicle === chosen);
  const row = useMemo(() => found && newestOf(found, one ? asked.askedAt : askedAt), [found, answer]);
  useEffect(() => {
    let timer = null;
    const end = onFrame((frame) => {
      view?.change(frame.changes.filter((change) => !filter.find.trim() || change.vehicle.toLowerCase().includes(filter.find.trim().toLowerCase())).filter((change) => !filter.verdicts.length || filter.verdicts.includes(change.verdict)));
      if (frame.many) view?.refresh();
      const grave = frame.changes.find((change) => change.verdict === 5);
      if (grave) setSaid(w.changed(grave.vehicle, wordOf(grave.verdict)));
      timer ??= setTimeout(() => { timer = null; again(); }, FRESH_LIST_MS / 4);
    });
    return () => {
      end();
      clearTimeout(timer);
    };
  }, [view, query]);
  const drawn = useRef(new Map());
  useEffect(() => { // tiles are some seconds old: what is listed otherwise than before stands above them
    const before = drawn.current;
    drawn.current = new Map((answer?.vehicles ?? []).map((v) => [v.vehicle, v.verdict]));
    view?.change((answer?.vehicles ?? []).filter((v) => before.has(v.vehicle) && before.get(v.vehicle) !== v.verdict));
  }, [view, answer]);
  useEffect(() => { view?.choose(chosen ? row : null, chosen ? trail : null); }, [view, chosen, row, trail]);
  const show = (place, zoom = VEHICLE_ZOOM) => place?.longitude_deg != null && view?.look([place.longitude_deg, place.latitude_deg], zoom);
  const choose = (found) => {
    setChosen(found.vehicle);
    show(found, 14);
  };
  const whole = () => {
    const e = answer?.extent;
    if (e) view?.map.fitBounds([[e.west, e.south], [e.east, e.north]], { padding: 50, maxZoom: 15, duration: 0 });
  };
  const total = answer ? answer.counts.reduce((n, c) => n + c.vehicles, 0) : 0;
  const note = answer && [w.total(total), ...(answer.never_reported ? [w.silent(answer.never_reported)] : [])].join(", ");
  return html`<div class="page fleet-page">
    <${Card} title=${w.title} id="fleet-map" class="map-card" note=${note}>
      ${answer && html`<${Counts} counts=${answer.counts} filter=${filter} setFilter=${setFilter} />`}
      ${missing ? html`<p class="note block" role="status">${missing}</p>` : html`<div class="stage map-stage"><div class="map-hold" role="group" aria-label=${w.label(note ?? "")}>
        ${answer && installed && html`<${Picture} installed=${installed} extent=${answer.extent} theme=${theme} query=${query} onView=${setView} onChoose=${setChosen} onMissing=${setMissing} />`}
        <div class="fleet-zoom"><button class="icon-only" onClick=${() => view?.zoomBy(1)} aria-label=${w.zoomIn}><${Icon} name="plus" /></button><button class="icon-only" onClick=${() => view?.zoomBy(-1)} aria-label=${w.zoomOut}><${Icon} name="minus" /></button><button onClick=${whole}>${w.all}</button></div>
      </div></div>`}
      <p class="note map-message">${w.legend}</p><p class="sr" role="alert">${said}</p>
      ${installed?.problem && html`<p class="note block">${installed.problem}</p>`}
    </${Card}>
    <${Card} title=${w.list} id="fleet-list" class="list-card">
      <${Filter} filter=${filter} setFilter=${setFilter} />
      <${Problem} text=${error} />
      ${chosen && html`<${Chosen} name=${chosen} row=${row} onCentre=${() => show(row)} onClose=${() => setChosen(null)} />`}
      ${answer ? html`<${List} answer=${answer} chosen=${chosen} onChoose=${choose} />` : !error && html`<p class="boot">${all.connecting}</p>`}
    </${Card}></div>`;
}
