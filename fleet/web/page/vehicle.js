// The page of one vehicle: its newest report with its age, events, gaps, keys, and the way to its own page.
import { useEffect } from "preact/hooks";
import { Card, Empty, Icon, Row, duration, html, metres } from "./unit/parts.js";
import { heard, may, newestOf, onFrame } from "./store.js";
import { Age, Problem, Table, Verdict, ageS, useAsked, utc } from "./parts.js";
import { nameOf, sentenceOf } from "./sentences.js";
import { w as all } from "./words.js";

const w = all.vehicle;
const EVERY_MS = 5000;
const NAME = /^[A-Za-z0-9_][A-Za-z0-9_-]{0,47}$/;

function Newest({ row, origins }) {
  if (row.utc_ms == null) return html`<${Empty} title=${w.none} why=${w.noneWhy} />`;
  const moving = row.north_m_s != null;
  const course = (((Math.atan2(row.east_m_s, row.north_m_s) * 180) / Math.PI) + 360) % 360;
  const speed = Math.hypot(row.north_m_s, row.east_m_s);
  return html`<dl class="rows">
    ${origins.length > 0 && html`<${Row} label=${w.rows.origin} value=${origins.map(w.origin).join(", ")} />`}
    <${Row} label=${w.rows.verdict} value=${html`<${Verdict} code=${row.verdict} ms=${row.utc_ms} />`} />
    <${Row} label=${w.rows.since} value=${utc(row.verdict_since_ms)} extra=${all.ago(duration(ageS(row.verdict_since_ms)))} />
    <${Row} label=${w.rows.report} value=${utc(row.utc_ms)} extra=${html`<${Age} ms=${row.utc_ms} />`} />
    <${Row} label=${w.rows.position} value=${row.latitude_deg == null ? all.unknown : `${row.latitude_deg.toFixed(6)}°, ${row.longitude_deg.toFixed(6)}°`} />
    ${row.position_ms != null && row.position_ms !== row.utc_ms && html`<${Row} label=${w.rows.positionAge} value=${utc(row.position_ms)} extra=${html`<${Age} ms=${row.position_ms} />`} />`}
    <${Row} label=${w.rows.height} value=${row.height_m == null ? all.unknown : row.height_m.toFixed(1)} unit=${row.height_m == null ? null : "m"} />
    <${Row} label=${w.rows.speed} value=${moving ? Math.round(speed * 3.6) : all.unknown} unit=${moving ? "km/h" : null} />
    ${moving && speed > 0.5 && html`<${Row} label=${w.rows.course} value=${`${Math.round(course) % 360}°`} />`}
    <${Row} label=${w.rows.level} value=${row.level_m == null ? w.noLevel : metres(row.level_m)} />
    <${Row} label=${w.rows.arrived} value=${utc(row.arrived_ms)} extra=${all.ago(duration(ageS(row.arrived_ms)))} />
    <${Row} label=${w.rows.enrolled} value=${utc(row.created_ms)} /></dl>
    ${row.erased && html`<p class="note">${w.erased}</p>`}`;
}

const Events = ({ events }) => (events.length === 0 ? html`<p class="dim">${w.noEvents}</p>` : html`<${Table} label=${w.events} columns=${[w.columns.time, w.columns.name, w.columns.content]}>
  ${events.map((e, i) => html`<tr key=${i}><td>${utc(e.utc_ms)}</td><th scope="row" title=${e.name}>${nameOf(e.name)}</th><td class="content-cell">${sentenceOf(e.name, e)}</td></tr>`)}</${Table}>`);

function Gaps({ gaps, epochs, aside }) {
  const missing = epochs.reduce((n, e) => n + Math.max(0, e.highest - e.received - e.lost), 0);
  return html`${gaps.length === 0 && missing === 0 ? html`<p class="dim">${w.noGaps}</p>` : html`<ul class="reasons">
      ${missing > 0 && html`<li>${w.missingReports(missing)}</li>`}
      ${gaps.map((g, i) => html`<li key=${i}>${utc(g.from_ms)} - ${utc(g.to_ms)}: ${w.gap(g.count)}</li>`)}</ul>`}
    ${aside.length > 0 && html`<h3 class="divide">${w.aside}</h3><ul class="reasons">${aside.map((a) => html`<li key=${a.reason}>${w.asideRow(a.batches, a.told ?? a.reason)}</li>`)}</ul>`}`;
}

function stateOf(key) {
  if (key.revoked_ms != null) return `${w.states.revoked} ${utc(key.revoked_ms)}${key.reason ? `, ${key.reason}` : ""}`;
  return key.to_ms != null && ageS(key.to_ms) > 0 ? w.states.ended : w.states.valid;
}

const Keys = ({ keys }) => html`<${Table} label=${w.keys} columns=${w.keyColumns}>
  ${keys.map((k) => html`<tr key=${k.key_id}><th scope="row"><code>${k.key_id}</code></th><td>${w.kinds[k.kind]}</td><td>${stateOf(k)}</td><td>${utc(k.made_ms)}</td><td>${utc(k.to_ms)}</td></tr>`)}</${Table}>`;

export function VehiclePage({ name }) {
  heard.value; // as on the map
  const { answer, error, status, again, askedAt } = useAsked(NAME.test(name) ? `api/vehicles/${name}` : null, EVERY_MS);
  useEffect(() => onFrame((frame) => (frame.many || frame.changes.some((c) => c.vehicle === name) || frame.alarms.some((a) => a.vehicle === name)) && again()), [name]);
  const back = html`<p><a href="#/map">${w.back}</a></p>`;
  if (!NAME.test(name) || [404, 422].includes(status)) return html`${back}<${Empty} title=${w.missing} why=${w.missingWhy} />`;
  if (!answer) return html`${back}${error ? html`<${Problem} text=${error} />` : html`<p class="boot">${all.connecting}</p>`}`;
  const vehicle = newestOf(answer.vehicle, askedAt);
  const revoked = answer.keys.length > 0 && answer.keys.every((key) => key.revoked_ms != null);
  return html`<div class="page vehicle-page"><div class="wide toolbar">${back}
      ${revoked ? html`<span class="note push">${w.revoked}</span>` : may("operate") && html`<span class="note push">${w.watchWhy}</span><a class="button" href=${`vehicles/${encodeURIComponent(name)}/live/`}><${Icon} name="now" /> ${w.watch}</a>`}</div>
    <${Problem} text=${error} />
    <${Card} title=${name} id="newest" note=${w.newest}><${Newest} row=${vehicle} origins=${answer.origins} />
      ${vehicle.alarms.length > 0 && html`<p><a href="#/alarms">${vehicle.alarms.map((kind) => all.map.alarms[kind]).join(", ")}</a></p>`}</${Card}>
    <${Card} title=${w.events} id="events"><${Events} events=${answer.events} /></${Card}>
    <${Card} title=${w.gaps} id="gaps"><${Gaps} gaps=${answer.gaps} epochs=${answer.epochs} aside=${answer.set_aside} /></${Card}>
    <${Card} title=${w.keys} id="keys"><${Keys} keys=${answer.keys} /></${Card}></div>`;
}
