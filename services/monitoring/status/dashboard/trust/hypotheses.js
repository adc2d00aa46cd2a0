// The hypotheses of what may be wrong, as a table of the page Trust.
import { useEffect, useState } from "preact/hooks";
import { link, nowMs, paused, state } from "../store.js";
import { Card, Empty, Icon, Row, StateIcon, duration, html, metres, monitorsStand, timeOfDay } from "../parts.js";
import { words } from "../words.js";
import { w } from "./hypothesis_words.js";

const POLL_MS = 1000;
const NO_DISTANCE_M = 0.01; // the page shows centimetres
const SUPERSCRIPTS = "⁰¹²³⁴⁵⁶⁷⁸⁹";

// A probability as people read it: per cent down to a thousandth, below it a power of ten.
export function probability(value) {
  if (value == null) return words.age.bar;
  if (value === 0) return "0";
  if (value >= 0.001) return `${Number(Math.min(100 * value, value < 1 ? 99.99 : 100).toPrecision(value > 0.99 ? 4 : 2))} %`;
  const power = Math.floor(Math.log10(value));
  return `${Number((value / 10 ** power).toPrecision(1))} × 10⁻${[...String(-power)].map((d) => SUPERSCRIPTS[d]).join("")}`;
}

const KEYS = ["nothing", "gnss", "imu", "odometer", "gnss_and_odometer", "receiver_time", "satellites"];
export const hypothesesNow = () => KEYS.map((key) => [key, state.value.trust.hypotheses[key]]).filter(([, row]) => row);
const byProbability = (a, b) => (b[1].probability ?? -1) - (a[1].probability ?? -1);

function stateOf(key, row) {
  if (!monitorsStand()) return ["stale", w.state.stale];
  if (row.acted_on) return ["unsafe", w.state.acted];
  if (row.survives === null) return ["off", w.state.unknown];
  if (!row.survives) return ["off", w.state.ruledOut];
  if (key === "nothing") return ["safe", w.state.suspected];
  return row.suspected ? ["caution", w.state.suspected] : ["info", w.state.kept];
}

function sinceText(ns) {
  const age = ns == null || nowMs() === null ? null : (nowMs() - ns / 1e6) / 1000;
  return age === null ? words.age.bar : words.trustPage.at(timeOfDay(ns / 1e6), duration(Math.max(0, age)));
}

const ratioText = (row) => (row.ratio == null ? words.age.bar : row.ratio.toFixed(2));

function place(row) {
  if (row.missing) return w.notEvaluated(row.missing);
  if (row.distance_m == null) return row.solutions ? w.satellites(row.solutions) : w.noSolution;
  if (row.distance_m < NO_DISTANCE_M) return w.published;
  return w.away(metres(row.distance_m));
}

// What the unit has beyond the stream: asked for once a second while somebody looks at it.
export function useReport(wanted) {
  const [report, setReport] = useState(null);
  useEffect(() => {
    if (!wanted) return undefined;
    let gone = false;
    const poll = async () => {
      if (!link.value.open || paused.value) return;
      try {
        const answer = await fetch("api/hypotheses", { signal: AbortSignal.timeout(POLL_MS * 3) });
        if (answer.ok && !gone) setReport(await answer.json());
      } catch {
        // The connection is lost, which the bar above says; it is asked again in a second.
      }
    };
    poll();
    const timer = setInterval(poll, POLL_MS);
    return () => {
      gone = true;
      clearInterval(timer);
    };
  }, [wanted]);
  return wanted ? report : null;
}

function Satellites() {
  const report = useReport(true);
  const rows = report?.satellites ?? [];
  if (!rows.length) return html`<p class="note block">${w.noSatellites}</p>`;
  return html`<div class="scroll satellite-rows" tabindex="0" role="group" aria-label=${w.openSatellites}><table class="plain">
    <thead><tr>${w.satelliteColumns.map((name) => html`<th scope="col">${name}</th>`)}</tr></thead>
    <tbody>${rows.map((r) => html`<tr key=${r.left_out.join()}><th scope="row">${r.left_out.join(", ")}</th>
      <td>${metres(r.distance_m)}</td><td>${metres(r.vertical_m)}</td><td>${metres(r.level_m)}</td>
      <td class=${r.ratio > 1 ? "above" : ""}>${ratioText(r)}</td><td>${r.innovations == null ? words.age.bar : r.innovations.toFixed(2)}</td></tr>`)}</tbody></table></div>
    <p class="note block">${w.satelliteNote}</p>`;
}

function Hypothesis({ name, row, open, onToggle }) {
  const [icon, word] = stateOf(name, row);
  const c = w.columns;
  const facts = [[c.distance, place(row)], [c.level, metres(row.level_m)], [c.since, monitorsStand() ? sinceText(row.since_ns) : words.age.bar]];
  const more = [[c.separation, ratioText(row)], [c.without, row.left_out ?? words.age.bar], [c.source, row.source ?? words.age.bar]];
  const id = `hypothesis-${name}`;
  return html`<tr class=${monitorsStand() ? "" : "old"}>
      <th scope="row"><button class="link fold" aria-expanded=${open} aria-controls=${id} onClick=${onToggle}><${Icon} name="next" />${row.label}</button>
        ${row.reason && html`<span class="reason dim">${row.reason}</span>`}</th>
      <td class="numbers"><strong>${probability(row.probability)}</strong>${row.prior !== null && html`<span class="reason dim">${w.prior(probability(row.prior))}</span>`}</td>
      <td><span class="with-icon outcome ${icon}"><${StateIcon} state=${icon} word="" /><strong>${word}</strong></span></td>
      ${facts.map(([, value]) => html`<td class="wide-only">${value}</td>`)}
    </tr>
    <tr class="folded" id=${id} hidden=${!open}><td colspan="6">${open && html`
      ${row.reason && html`<p class="narrow-only">${row.reason}</p>`}<dl class="rows narrow-only">${facts.map(([label, value]) => html`<${Row} label=${label} value=${value} />`)}</dl>
      <dl class="rows">${more.map(([label, value]) => html`<${Row} label=${label} value=${value} />`)}</dl>
      ${name === "satellites" && html`<${Satellites} />`}`}</td></tr>`;
}

export function HypothesesCard() {
  const [open, setOpen] = useState({});
  const rows = hypothesesNow();
  const known = rows.filter(([, row]) => row.probability !== null).sort(byProbability);
  const shown = [...known, ...rows.filter(([, row]) => row.probability === null)];
  const c = w.columns;
  if (!rows.length) return html`<${Card} title=${w.title} id="hypotheses" class="hypotheses-card"><${Empty} title=${w.empty} why=${w.emptyWhy} /></${Card}>`;
  return html`<${Card} title=${w.title} note=${monitorsStand() ? w.note : w.old} id="hypotheses" fold class="hypotheses-card">
    <table class="plain monitors hypotheses"><thead><tr>${["hypothesis", "probability", "state"].map((name) => html`<th scope="col">${c[name]}</th>`)}
      ${["distance", "level", "since"].map((name) => html`<th scope="col" class="wide-only">${c[name]}</th>`)}</tr></thead>
      <tbody>${shown.map(([name, row]) => html`<${Hypothesis} key=${name} name=${name} row=${row} open=${Boolean(open[name])}
        onToggle=${() => setOpen((now) => ({ ...now, [name]: !now[name] }))} />`)}</tbody></table>
  </${Card}>`;
}
