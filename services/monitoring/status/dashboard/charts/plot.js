// A chart of lines over time; all charts of a page share the cursor. Drawn by uPlot, which is loaded when it is needed.
import { useEffect } from "preact/hooks";
import { signal } from "@preact/signals";
import { html, themeName, timeOfDay, usePlot } from "../parts.js";

export const cursor = signal(null); // index of the sample under the cursor, in all charts

// Colour and dashes of a line: tellable apart without colour.
export const STYLES = [
  { colour: "--fused", dash: [], width: 2.25 },
  { colour: "--gnss", dash: [8, 4], width: 2 },
  { colour: "--odometer", dash: [2, 3], width: 2.25 },
  { colour: "--truth", dash: [10, 3, 2, 3], width: 2 },
  { colour: "--mark-info", dash: [14, 4], width: 1.75 },
  { colour: "--mark-caution", dash: [4, 4], width: 1.75 },
  { colour: "--text", dash: [1, 4], width: 1.75 },
  { colour: "--soft", dash: [], width: 1.5 },
];
export const LIMIT_STYLE = { colour: "--mark-unsafe", dash: [6, 4], width: 1.75 };

const STEPS_S = [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800];
const clockText = (s) => timeOfDay(s * 1000);

function options(size, lines, label) {
  const style = getComputedStyle(document.documentElement);
  const colour = (name) => style.getPropertyValue(name).trim();
  const axis = { stroke: colour("--soft"), grid: { stroke: colour("--line"), width: 1 }, ticks: { show: false }, font: "12px system-ui" };
  // A gap is a pause longer than the deadline of the topic; shorter ones are those between two samples.
  const gaps = (limit) => (u, _s, _a, _b, found) => found.filter(([from, to]) => u.posToVal(to, "x", true) - u.posToVal(from, "x", true) > limit);
  return {
    ...size,
    legend: { show: false },
    padding: [10, 14, 0, 0],
    cursor: { y: false, drag: { x: false, y: false }, sync: { key: "obu", scales: ["x", null] }, points: { size: 6 } },
    scales: { x: { time: false }, y: { range: (_u, low, high) => padded(low, high) } },
    axes: [
      { ...axis, size: 30, space: 78, incrs: STEPS_S, values: (_u, ticks) => ticks.map(clockText) },
      { ...axis, size: 58, label, labelSize: 20, labelFont: "12px system-ui", values: (_u, ticks) => ticks.map((v) => short(v)) },
    ],
    series: [{}, ...lines.map((line) => ({
      stroke: colour(line.style.colour), width: line.style.width, dash: line.style.dash, points: { show: false }, auto: !line.outside, gaps: gaps(line.gapS),
    }))],
    hooks: { setCursor: [(u) => { cursor.value = u.cursor.left < 0 || u.cursor.idx == null ? null : u.cursor.idx; }] },
  };
}

function padded(low, high) {
  if (low == null || high == null) return [0, 1];
  const margin = high > low ? (high - low) * 0.06 : Math.abs(high) * 0.05 || 1;
  return [low >= 0 && low < 0.3 * high ? 0 : low - margin, high + margin];
}

// A number with that many digits that count; more where they are in front of the point.
export function short(v, digits = 6) {
  if (v !== 0 && (Math.abs(v) < 1e-3 || Math.abs(v) >= 1e7)) return v.toExponential(Math.min(digits, 3) - 1);
  return String(+v.toPrecision(Math.max(digits, Math.floor(Math.log10(Math.abs(v) || 1)) + 3)));
}

export function Plot({ time, lines, columns, label, axisLabel, span }) {
  const data = [time, ...columns];
  const range = (plot) => {
    const last = time.at(-1) ?? 1;
    plot?.setScale("x", { min: last - span, max: last });
  };
  const shape = `${themeName()} ${axisLabel} ${lines.map((l) => l.key).join()}`;
  const [box, plot] = usePlot(shape, (Library, size, element) => {
    const made = new Library(options(size, lines, axisLabel), data, element);
    range(made);
    return made;
  });
  useEffect(() => {
    plot.current?.setData(data, false);
    range(plot.current);
  }, [time, shape]);
  // Arrow keys move the cursor of all charts.
  const moved = (event) => {
    const steps = { ArrowLeft: -1, ArrowRight: 1, PageDown: -30, PageUp: 30 }[event.key];
    if (!steps || !plot.current || time.length === 0) return;
    event.preventDefault();
    const index = Math.min(Math.max((cursor.value ?? time.length - 1) + steps, 0), time.length - 1);
    plot.current.setCursor({ left: plot.current.valToPos(time[index], "x"), top: 10 });
  };
  return html`<div class="plot-frame" role="img" aria-label=${label} tabindex="0" onKeyDown=${moved}><div class="plot" ref=${box}></div></div>`;
}

export const Key = ({ style }) => html`<svg class="line-key" width="28" height="8" aria-hidden="true"><path d="M1 4H27" style=${{ stroke: `var(${style.colour})`, strokeWidth: style.width, strokeDasharray: style.dash.join(" ") }} /></svg>`;
