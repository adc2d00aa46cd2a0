// The page that most people open: where the vehicle is, how well that is known, and what the sources say.
import { useEffect, useState } from "preact/hooks";
import { brokerAnswers, clock, history, isLive, isOld, isPast, link, nowMs, state } from "./store.js";
import {
  Age, Band, Card, Empty, Row, STATUS_STATE, StateIcon, bandsOf, checksNow, compass, degrees, duration, fixed, html, metres, percent, seconds, themeName, timeOfDay, usePlot, lengthFactor, lengthUnit, speedFactor, speedUnit } from "./parts.js";
import { CloseUp, scene } from "./closeup.js";
import { words } from "./words.js";


function PositionCard() {
  const p = words.position;
  const { solution: s, fix, satellites, navigation, truth, mode } = state.value;
  clock.value;
  if (!s) return html`<${Card} title=${p.title} id="position"><${Empty} title=${p.empty} why=${p.emptyWhy} /></${Card}>`;
  const old = isPast(s) ? "old" : "";
  const why = navigation && !isOld("navigation/state", navigation.updated_ns) && s.phase !== "navigating" ? navigation.reason : null;
  const digits = s.ellipse.semi_major_m < 0.1 ? 7 : 6;
  const { stale, withinM } = scene();
  const off = truth?.error_north_m == null ? null : Math.hypot(truth.error_north_m, truth.error_east_m);
  return html`<${Card} title=${p.title} id="position" aside=${html`<${Age} topic="navigation/solution" stamp=${s.updated_ns} />`}>
    <div class="lead ${old}">
      <dl class="coordinates">
        <div><dt>${p.latitude}</dt><dd>${fixed(s.latitude_deg, digits)}<span aria-hidden="true">°</span><span class="sr"> ${p.degrees}</span></dd></div>
        <div><dt>${p.longitude}</dt><dd>${fixed(s.longitude_deg, digits)}<span aria-hidden="true">°</span><span class="sr"> ${p.degrees}</span></dd></div>
      </dl>
      <p class="accuracy">${stale ? p.upTo(metres(withinM)) : html`<span>±</span> ${metres(s.ellipse.semi_major_m)} <span class="note">${p.error95}</span>`}</p>
    </div>
    <dl class="rows ${old}">
      <${Row} label=${p.speed} value=${fixed(s.speed_m_s * speedFactor(), 1)} unit=${speedUnit()} unitName=${words.speed.unitNames[speedUnit()]} extra=${s.stationary ? p.standing : null} />
      <${Row} label=${p.heading} value=${`${fixed(compass(s.heading_rad), 1).padStart(5, "0")}°`} extra=${`± ${fixed(degrees(s.heading_sd_rad), 1)}° (${p.sigma})`} />
      <${Row} label=${p.height} value=${fixed(s.height_msl_m == null ? null : s.height_msl_m * lengthFactor(), 1)} unit=${lengthUnit()[0]} unitName=${lengthUnit()[1]} extra=${p.heightNote(metres(Math.hypot(s.height_sd_m, s.geoid_sd_m ?? 0)), s.geoid, `${fixed(s.height_ellipsoid_m * lengthFactor(), 1)} ${lengthUnit()[0]}`)} />
      ${s.protection_level_horizontal_m != null && html`<${Row} label=${p.levels} value=${p.levelsValue(metres(s.protection_level_horizontal_m), metres(s.protection_level_vertical_m))}
        extra=${old ? p.levelsOld : p.levelsMeaning(Math.round(1 / s.integrity_risk).toLocaleString("en"))} />`}
      <${Row} label=${p.phase} value=${p.phases[s.phase] ?? s.phase} extra=${why} />
      <${Row} label=${p.gnssUsed} value=${s.gnss_age_s == null ? p.never : p.ago(s.gnss_age_s < 1 ? words.age.now : duration(s.gnss_age_s))} />
      ${off !== null && html`<${Row} label=${p.truthError} value=${metres(off)} extra=${p.truthNote} />`}
    </dl>
    <${FixRows} fix=${fix} satellites=${satellites} mode=${mode} />
  </${Card}>`;
}

function FixRows({ fix, satellites, mode }) {
  const p = words.position;
  if (!fix) return html`<p class="note block">${p.fix}: ${words.topics.never}</p>`;
  const old = isOld("gnss/fix", fix.updated_ns) ? "old" : "";
  const inView = satellites && !isOld("gnss/satellites", satellites.updated_ns) ? satellites.in_view : null;
  const modeOld = mode && isOld("mode/state", mode.updated_ns);
  const carrier = p.carrier[fix.carrier_solution];
  return html`<h3 class="divide">${p.fix}<${Age} topic="gnss/fix" stamp=${fix.updated_ns} /></h3>
    <dl class="rows ${old}">
      <${Row} label=${p.kind} value=${[p.fixType[fix.fix_type], carrier].filter(Boolean).join(", ")} />
      <${Row} label=${p.satellites} value=${fix.satellites_used == null ? "-" : p.satellitesOf(fix.satellites_used, inView)} />
      <${Row} label=${p.correction} value=${fix.correction_age_s == null ? p.correctionNone : p.correctionAge(`${fixed(fix.correction_age_s, 1)} s`)} />
    </dl>
    ${mode && html`<dl class="rows ${modeOld ? "old" : ""}"><${Row} label=${p.mode} value=${mode.mode.replaceAll("_", " ")} extra=${modeOld ? html`<${Age} topic="mode/state" stamp=${mode.updated_ns} />` : null} /></dl>`}`;
}

// What the phone shows right under the picture; the cards below say the same at length.
function Glance() {
  const g = words.glance;
  const { solution: s, fix } = state.value;
  clock.value;
  const sc = scene();
  if (!sc) return null;
  const kind = !fix || isOld("gnss/fix", fix.updated_ns) ? words.topics.stale
    : words.position.carrier[fix.carrier_solution] || words.position.fixType[fix.fix_type];
  const cells = [
    [g.speed, html`<span class="value">${fixed(s.speed_m_s * speedFactor(), 1)}</span><small> ${speedUnit()}</small>`],
    [g.fix, kind],
    [sc.stale ? words.position.away : words.position.error95, html`${sc.stale ? "≤" : "±"} ${metres(sc.stale ? sc.withinM : s.ellipse.semi_major_m)}`],
    ...(s.protection_level_horizontal_m == null || sc.stale ? [] : [[g.level, metres(s.protection_level_horizontal_m)]]),
    [g.age, html`<${Age} topic="navigation/solution" stamp=${s.updated_ns} />`],
  ];
  return html`<dl class="card glance ${sc.stale ? "old" : ""}">${cells.map(([label, value]) => html`<div><dt>${label}</dt><dd>${value}</dd></div>`)}</dl>`;
}

function TrustCard({ onWhy }) {
  const t = words.trustCard;
  clock.value;
  const { now_ns: nowNs, banner, timeline } = state.value;
  const checks = checksNow(banner);
  const monitors = checks.filter((c) => c.kind === "monitor");
  const idle = monitors.filter((c) => c.state === "off"); // in one line: the page Trust says why
  const shown = [...monitors.filter((c) => c.state !== "off"), ...checks.filter((c) => c.kind === "input")];
  const good = shown.filter((c) => c.state === "safe").length; // a phone shows their number
  return html`<${Card} title=${t.title} note=${t.span} id="trust" aside=${html`<span><button class="link" onClick=${onWhy}>${t.all}</button> <a href="#/trust">${t.page}</a></span>`}>
    <${Band} bands=${bandsOf(timeline, nowNs)} nowNs=${nowNs} />
    <p class="axis" aria-hidden="true"><span>${t.ago}</span><span>${t.now}</span></p>
    <ul class="checks">
    ${monitors.length === 0 && html`<li class="unmonitored"><${StateIcon} state="stale" word="" /><span>${t.noMonitors}</span></li>`}
    ${idle.length > 0 && html`<li class="unmonitored"><${StateIcon} state="off" word="" /><span><strong>${words.trust.off}</strong>
      <span class="dim">${" "}${idle.map((c) => c.label).join(", ")}</span></span></li>`}
    ${shown.map((c) => html`<li class=${c.state}>
      <${StateIcon} state=${c.state} word=${words.check[c.state]} /><span>${c.label}</span><span class="dim">${c.text}</span>
    </li>`)}
    ${good > 0 && html`<li class="narrow-only"><${StateIcon} state="safe" word="" /><span>${t.inOrder(good)}</span></li>`}</ul>
  </${Card}>`;
}

const LOST = new Set(["lost", "missing", "restarting"]); // of a process that should run

function ServicesCard() {
  const { processes, chain, bus } = state.value;
  clock.value;
  const live = isLive() && brokerAnswers();
  const shown = Object.entries(processes).filter(([, p]) => p.status !== "absent")
    .map(([name, p]) => [name, live ? p : { ...p, status: "unknown" }]);
  const order = ["lost", "missing", "stale", "ended", "restarting", "waiting", "unknown", "late", "ready"];
  shown.sort((a, b) => order.indexOf(a[1].status) - order.indexOf(b[1].status));
  return html`<${Card} title=${words.services.title} id="services" fold=${!shown.some(([, p]) => LOST.has(p.status))} note=${live ? words.services.running(chain.services.up, chain.services.of) : words.status.unknown}
    aside=${html`<a href="#/system">${words.services.details}</a>`}>
    <ul class="services">${shown.map(([name, p]) => html`<li>
      <a href=${`#/system?node=${name}`}><${StateIcon} state=${STATUS_STATE[p.status]} word=${words.status[p.status]} /><span>${name}</span>
      <span class="dim">${p.status === "ready" ? percent(p.cpu_share) : words.status[p.status]}</span></a>
    </li>`)}</ul>
    ${live && bus.delay_p95_s != null && html`<p class="note block">${words.services.note(seconds(bus.delay_p95_s))}</p>`}
  </${Card}>`;
}

const SERIES = [["fused", "speed_fused_m_s", []], ["gnss", "speed_gnss_m_s", [8, 4]], ["odometer", "speed_odometer_m_s", [2, 3]]];

function plotData() {
  const last = history.time_ns.at(-1) ?? 0;
  const columns = SERIES.map(([, field]) => (history.fields[field] ?? []).map((v) => (v == null ? null : v * speedFactor())));
  return [history.time_ns.map((ns) => (ns - last) / 1e9), ...columns];
}

function plotOptions(size) {
  const style = getComputedStyle(document.documentElement);
  const colour = (name) => style.getPropertyValue(name).trim();
  const axis = { stroke: colour("--soft"), grid: { stroke: colour("--line"), width: 1 }, ticks: { show: false }, font: "12px system-ui" };
  return {
    ...size,
    legend: { show: false },
    cursor: { show: false },
    padding: [8, 12, 0, 0],
    scales: { x: { time: false, range: [-60, 0] }, y: { range: (_u, low, high) => [Math.max(0, Math.min(low ?? 0, (high ?? 0) - 10) - 2), (high ?? 8) + 3] } },
    axes: [{ ...axis, values: (_u, ticks) => ticks.map((t) => (t === 0 ? words.trustCard.now : `${t} s`)), size: 30 }, { ...axis, size: 44 }],
    series: [{}, ...SERIES.map(([name, , dash]) => ({ stroke: colour(`--${name}`), width: name === "fused" ? 2.5 : 2, dash, points: { show: false } }))],
  };
}

function Plot({ theme }) {
  const [box, plot] = usePlot(theme, (Library, size, element) => new Library(plotOptions(size), plotData(), element));
  useEffect(() => plot.current?.setData(plotData()));
  return html`<div class="plot" ref=${box}></div>`;
}

function newest(field) {
  const value = history.fields[field]?.at(-1);
  return value == null ? null : value * speedFactor();
}

function SpeedCard() {
  const t = words.speed;
  const [table, setTable] = useState(false);
  state.value;
  const values = SERIES.map(([name, field]) => [name, t[name], newest(field)]);
  const any = SERIES.some(([, field]) => history.fields[field]?.some((v) => v != null));
  const described = values.map(([, label, v]) => `${label} ${v === null ? words.topics.stale : `${v.toFixed(1)} ${t.unitNames[speedUnit()]}`}`).join(", ");
  const rows = history.time_ns.map((ns, i) => [ns, i]).filter(([, i]) => (history.time_ns.length - 1 - i) % 25 === 0).reverse();
  return html`<${Card} title=${t.title} note=${t.last} id="speed" fold class="speed-card"
    aside=${any && html`<button class="link" aria-pressed=${table} onClick=${() => setTable(!table)}>${table ? words.closeup.picture : words.closeup.table}</button>`}>
    ${!any ? html`<${Empty} title=${t.empty} />`
      : table ? html`<div class="scroll" tabindex="0" role="group" aria-label=${t.title}><table class="plain"><thead><tr><th scope="col">${t.time}</th>${values.map(([, label]) => html`<th scope="col">${label}, ${speedUnit()}</th>`)}</tr></thead>
          <tbody>${rows.map(([ns, i]) => html`<tr><th scope="row">${timeOfDay(ns / 1e6)}</th>${SERIES.map(([, f]) => html`<td>${fixed(history.fields[f]?.[i] == null ? null : history.fields[f][i] * speedFactor(), 1)}</td>`)}</tr>`)}</tbody></table></div>`
      : html`<div role="img" aria-label=${t.label(described)}><${Plot} theme=${themeName()} /></div>`}
    <ul class="legend">${values.map(([name, label, v]) => html`<li><span class="key ${name}"></span><span>${label}</span><strong>${fixed(v, 1)}</strong><span class="dim">${speedUnit()}</span></li>`)}</ul>
  </${Card}>`;
}

export function NowPage({ onWhy }) {
  link.value;
  nowMs();
  return html`<div class="page now"><${CloseUp} /><${Glance} /><${PositionCard} /><${TrustCard} onWhy=${onWhy} /><${SpeedCard} /><${ServicesCard} /></div>`;
}
