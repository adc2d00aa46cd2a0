// The page Charts: the last minutes or hour of speeds, heights, errors, innovations, biases, latencies, signals, and of
// any field that was chosen in the topic inspector. The unit keeps all fields named here from its start.
import { useEffect, useState } from "preact/hooks";
import { contract, link, paused, remember, settings, togglePause } from "../store.js";
import { Card, Empty, html, timeOfDay, speedFactor, speedUnit } from "../parts.js";
import { Key, LIMIT_STYLE, Plot, STYLES, cursor, short } from "./plot.js";
import { follow, resumeSeries, series } from "./series.js";
import { chartWords as w } from "./chart_words.js";
import { words } from "../words.js";

const DEGREES = 180 / Math.PI;
const UNFOLDED = 2; // charts on a phone
const SPANS_S = [60, 300, 900, 3600];
const SIGMAS = [1, 2, 3];
const LATENCIES = ["gnss/fix", "imu/sample", "vehicle/wheel_speed", "navigation/solution", "trust/state"];
const MILLI = 1000;

const line = (field, label, extra = {}) => ({ field, label, ...extra });
const errorLines = (axis, limit, level) => [
  line(`computed:error_${axis}_m`, w.error),
  ...SIGMAS.map((n) => line(`computed:${axis}_sd_m`, w.sigma(n), { factor: n, style: { colour: "--odometer", dash: [[], [6, 3], [2, 3]][n - 1], width: 1.5 } })),
  line(level, w.level, { style: STYLES[1] }),
  line(limit, w.alertLimit, { style: LIMIT_STYLE, outside: true }),
];
const axes = (field) => ["forward", "right", "down"].map((axis, i) => line(`${field}.${i}`, w.axis[axis]));

const CHARTS = [
  { id: "speed", get unit() { return speedUnit(); }, get factor() { return speedFactor(); }, lines: [line("computed:speed_m_s", w.fused), line("gnss/fix:ground_speed_m_s", w.gnss), line("computed:speed_odometer_m_s", w.odometer), line("computed:speed_carrier_m_s", w.carrier), line("computed:speed_truth_m_s", w.truth)] },
  { id: "height", unit: "m", lines: [line("navigation/solution:height_ellipsoid_m", w.fused), line("gnss/fix:height_ellipsoid_m", w.gnss), line("truth/state:height_ellipsoid_m", w.truth, { style: STYLES[3] })] },
  { id: "horizontal", unit: "m", lines: errorLines("horizontal", "trust/state:alert_limit_horizontal_m", "navigation/solution:protection_level_horizontal_m") },
  { id: "vertical", unit: "m", lines: errorLines("vertical", "trust/state:alert_limit_vertical_m", "navigation/solution:protection_level_vertical_m") },
  { id: "innovations", unit: "", limit: [1, w.gate], lines: Object.entries(w.aiding).map(([kind, label]) => line(`navigation/aiding[${kind}]:test_ratio`, label)) },
  { id: "latency", unit: "ms", factor: MILLI, lines: LATENCIES.map((topic) => line(`${topic}:@latency_s`, topic)) },
  { id: "accelerometer", unit: "m/s²", lines: axes("navigation/solution:accelerometer_bias_m_s2") },
  { id: "gyroscope", unit: "°/s", factor: DEGREES, lines: axes("navigation/solution:gyroscope_bias_rad_s") },
  { id: "cn0", unit: "dBHz", lines: Object.entries(w.constellation).map(([name, label]) => line(`computed:cn0_${name}_db_hz`, label)) },
  { id: "satellites", unit: "", lines: [line("computed:satellites_used", w.used), line("computed:satellites_in_view", w.inView)] },
  { id: "dop", unit: "", lines: [line("gnss/fix:pdop", "PDOP"), line("gnss/fix:hdop", "HDOP"), line("gnss/fix:vdop", "VDOP")] },
  { id: "heading", unit: "°", factor: DEGREES, lines: [line("computed:heading_sd_rad", w.headingSd)] },
  { id: "ages", unit: "s", lines: [line("gnss/fix:correction_age_s", w.correctionAge), line("navigation/solution:gnss_age_s", w.gnssAge)] },
].map((chart) => ({ ...chart, title: w.charts[chart.id].title, note: w.charts[chart.id].note }));

const plots = () => settings.value.plots ?? [];
export const plotted = (field) => plots().includes(field);
export function plot(field, on) {
  remember({ plots: on ? [...new Set([...plots(), field])] : plots().filter((name) => name !== field) });
}

// Chosen fields: those of one unit share a chart.
function ownCharts(described) {
  const byUnit = new Map();
  for (const field of plots()) {
    const { unit = "", axis = "" } = described[field] ?? {};
    byUnit.set(unit, [...(byUnit.get(unit) ?? []), line(field, axis ? `${field} (${axis})` : field, { own: true })]);
  }
  return [...byUnit].map(([unit, lines]) => ({ id: `own-${unit.replace(/[^a-z0-9]/gi, "_")}`, title: w.own(unit), note: "", unit, lines }));
}

function topicOf(field) {
  const name = field.split(":")[0].replace(/\[.*\]/, "");
  return contract.value.topics[name] ?? contract.value.topics[name.replace(/\/[^/]*$/, "/+")];
}

function prepared(chart) {
  const { columns } = series.value;
  const lines = chart.lines.map((l, i) => ({
    ...l, key: `${l.field} ${l.factor ?? 1}`, style: l.style ?? STYLES[i % STYLES.length], gapS: Math.max(topicOf(l.field)?.stale_after_s ?? 5, 3),
  }));
  const values = lines.map((l) => {
    const factor = (chart.factor ?? 1) * (l.factor ?? 1);
    const column = columns[l.field] ?? [];
    return factor === 1 ? column : column.map((v) => (v === null ? null : v * factor));
  });
  const shown = lines.map((l, i) => [l, values[i]]).filter(([l, column]) => l.own || column.some((v) => v !== null));
  if (chart.limit && shown.length > 0) {
    shown.push([{ key: "limit", field: "", label: chart.limit[1], style: LIMIT_STYLE, gapS: 5, fixed: true }, series.value.time.map(() => chart.limit[0])]);
  }
  return { lines: shown.map(([l]) => l), columns: shown.map(([, column]) => column) };
}

// The value under the cursor, or the newest: at most as old as a gap.
function valueAt(column, gapS) {
  const { period } = series.value;
  const place = cursor.value ?? column.length - 1;
  for (let i = place; i >= 0 && (place - i) * period <= gapS; i -= 1) if (column[i] != null) return column[i];
  return null;
}

function ChartCard({ chart, span, fold }) {
  const [table, setTable] = useState(false);
  const { time } = series.value;
  const { lines, columns } = prepared(chart);
  const unit = chart.unit ? `, ${chart.unit}` : "";
  const now = lines.map((l, i) => [l, valueAt(columns[i], l.gapS)]);
  const described = now.map(([l, v]) => `${l.label} ${v === null ? w.noValue : `${short(v, 3)} ${chart.unit}`}`).join(", ");
  const step = Math.max(1, Math.round(time.length / 30));
  const rows = time.map((_, i) => i).filter((i) => (time.length - 1 - i) % step === 0).reverse();
  const empty = lines.every((_, i) => columns[i].every((v) => v == null));
  return html`<${Card} title=${chart.title} note=${chart.note} id=${`chart-${chart.id}`} fold=${fold} class="chart-card"
    aside=${!empty && html`<button class="link" aria-pressed=${table} onClick=${() => setTable(!table)}>${table ? words.closeup.picture : words.closeup.table}</button>`}>
    ${empty ? html`<${Empty} title=${w.emptyField} why=${w.emptyFieldWhy} />`
      : table ? html`<div class="scroll" tabindex="0" role="group" aria-label=${chart.title}><table class="plain"><thead><tr><th scope="col">${w.time}</th>${lines.map((l) => html`<th scope="col">${l.label}${unit}</th>`)}</tr></thead>
          <tbody>${rows.map((i) => html`<tr><th scope="row">${timeOfDay(time[i] * 1000)}</th>${columns.map((column) => html`<td>${column[i] == null ? "-" : short(column[i], 4)}</td>`)}</tr>`)}</tbody></table></div>`
      : html`<${Plot} time=${time} lines=${lines} columns=${columns} span=${span} axisLabel=${chart.unit || w.dimensionless[chart.id] || w.noUnit} label=${w.label(chart.title, described)} />`}
    <ul class="legend lines-legend">${now.map(([l, v]) => html`<li key=${l.key}><${Key} style=${l.style} /><span>${l.label}</span>
      <strong>${v === null ? "-" : short(v, 3)}</strong>${chart.unit && html`<span class="dim">${chart.unit}</span>`}
      ${l.own && html`<button class="link" onClick=${() => plot(l.field, false)} aria-label=${w.removeField(l.field)}>${w.remove}</button>`}</li>`)}</ul>
  </${Card}>`;
}

export function ChartsPage() {
  link.value;
  const span = SPANS_S.includes(settings.value.chartSpan) ? settings.value.chartSpan : 300;
  const own = plots();
  const fields = [...new Set([...CHARTS.flatMap((chart) => chart.lines.map((l) => l.field)), ...own])];
  useEffect(() => {
    cursor.value = null;
    return follow(fields, span);
  }, [fields.join(), span]);
  useEffect(() => {
    if (!paused.value) resumeSeries();
  }, [paused.value]);
  const { time, refused, loaded } = series.value;
  const filled = CHARTS.filter((chart) => prepared(chart).lines.length > 0);
  const silent = CHARTS.filter((chart) => !filled.includes(chart));
  const at = cursor.value !== null && time[cursor.value] ? timeOfDay(time[cursor.value] * 1000) : null;
  return html`<div class="page charts-page">
    <div class="toolbar chart-tools" role="group" aria-label=${w.tools}>
      ${SPANS_S.map((s) => html`<button key=${s} aria-pressed=${s === span} onClick=${() => remember({ chartSpan: s })}>${w.span(s / 60)}</button>`)}
      <button aria-pressed=${paused.value} onClick=${togglePause}>${paused.value ? words.resume : words.pause}</button>
      <span class="dim cursor-time">${at ? w.atCursor(at) : w.cursorHint}</span>
    </div>
    ${refused && html`<p class="verdict" role="status">${w.refused(refused)}</p>`}
    ${!loaded ? html`<p class="note">${w.loading}</p>` : html`
    ${ownCharts(series.value.fields).map((chart) => html`<${ChartCard} key=${chart.id} chart=${chart} span=${span} />`)}
    ${filled.map((chart, i) => html`<${ChartCard} key=${chart.id} chart=${chart} span=${span} fold=${i >= UNFOLDED} />`)}
    ${filled.length === 0 && own.length === 0 && html`<${Card} title=${w.title} id="charts-empty"><${Empty} title=${w.empty} why=${w.emptyWhy} /></${Card}>`}
    <${Card} title=${w.moreTitle} id="chart-more" class="more-card"><p>${w.more} <a href="#/system">${w.moreLink}</a></p>
      ${silent.length > 0 && html`<p class="dim">${w.silent(silent.map((chart) => chart.title).join(", "))}</p>`}</${Card}>`}
  </div>`;
}
