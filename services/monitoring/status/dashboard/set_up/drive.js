// The drive: what to do next, how far everything is known, and the findings that one press applies.
import { useEffect, useRef, useState } from "preact/hooks";
import { isLive, state } from "../store.js";
import { Icon, html } from "../parts.js";
import { Centre, Certificate } from "./certificate.js";
import { Ring } from "./pictures.js";
import { language, setUpWords as w } from "./set_up_words.js";

const AGAIN_MS = 120000; // between two surveys of a drive that goes on
const BEND_RAD = 1.2;
const BRAKED_M_S = 2.5;
const STRAIGHT_M_S = 20 / 3.6;
const REPEAT_MS = 15000;
const VERDICT = { unknown: "off", agrees: "safe", contradicts: "caution" };

// Kept while the browser shows the pages: what the drive has shown is measured by the unit, these only choose words.
const seen = { left: 0, right: 0, brakes: 0, turned: 0, heading: null, peak: 0 };

function note(solution) {
  const { heading_rad: heading, speed_m_s: speed } = solution;
  if (heading != null && seen.heading !== null && speed > 1.5) {
    const step = Math.atan2(Math.sin(heading - seen.heading), Math.cos(heading - seen.heading));
    seen.turned = Math.abs(step) < 0.002 ? seen.turned * 0.98 : seen.turned + step;
    if (Math.abs(seen.turned) > BEND_RAD) {
      seen[seen.turned > 0 ? "right" : "left"] += 1;
      seen.turned = 0;
    }
  }
  seen.heading = heading ?? seen.heading;
  seen.peak = Math.max(seen.peak, speed);
  if (speed < seen.peak - BRAKED_M_S) {
    seen.brakes += 1;
    seen.peak = speed;
  }
}

export function instructionOf(findings, speed) {
  if (findings?.length && findings.every((f) => f.verdict !== "unknown")) return "done";
  if (speed === null || (!findings && speed < 0.5 && seen.brakes === 0)) return "stand";
  if (speed < STRAIGHT_M_S && seen.brakes * 2 <= seen.left + seen.right) return "straight";
  if (seen.brakes * 2 <= seen.left + seen.right) return "brake";
  return seen.left <= seen.right ? "left" : "right";
}

function speak(text) {
  if (!window.speechSynthesis) return;
  const said = new SpeechSynthesisUtterance(text);
  said.lang = language;
  speechSynthesis.cancel();
  speechSynthesis.speak(said);
}

function Instruction({ report }) {
  const [voice, setVoice] = useState(false);
  const spoken = useRef({ text: "", at: 0 });
  const solution = state.value?.solution;
  useEffect(() => {
    if (solution && isLive()) note(solution);
  }, [solution?.updated_ns]);
  const text = w.instruction[instructionOf(report.survey.result?.findings, report.speed_m_s)];
  useEffect(() => {
    const due = text !== spoken.current.text || performance.now() - spoken.current.at > REPEAT_MS;
    if (!voice || !due) return;
    spoken.current = { text, at: performance.now() };
    speak(text);
  });
  return html`<p class="instruction" role="status">${text}</p>
    <p class="note">${w.shown}: ${w.counts(seen.left, seen.right, seen.brakes)}</p>
    ${window.speechSynthesis && html`<label class="switch"><input type="checkbox" checked=${voice} onChange=${(e) => setVoice(e.target.checked)} /> ${w.voice}</label>`}`;
}

const shown = (value, unit) => (unit === "-" ? `${(100 * value).toFixed(2)} %` : `${value.toPrecision(2)} ${unit}`);

function Finding({ row, applied }) {
  const name = w.quantities[row.quantity];
  const percent = Math.round(100 * row.known);
  return html`<li class="finding"><${Ring} share=${row.known} state=${row.verdict}>${percent}</${Ring}>
    <div><strong>${name}</strong> <${Icon} name=${VERDICT[row.verdict]} /> ${applied ? w.applied : w.verdicts[row.verdict]}
      <p class="note">${w.known(percent)}${row.sd !== null && `; ${w.offBy(shown(row.difference, row.unit), shown(row.sd, row.unit))}`}</p></div></li>`;
}

export const pendingOf = (survey) => (survey.result?.findings ?? []).filter((f) => f.verdict === "contradicts" && !survey.applied.includes(f.quantity));

function Proposal({ pending, values }) {
  const rows = pending.flatMap((f) => Object.entries(f.changes));
  return html`<h3>${w.proposed}</h3><ul class="differences">${rows.map(([name, value]) => html`<li key=${name}><code>${name}</code>
    <span> ${values[name] ?? ""} → <strong>${JSON.stringify(value)}</strong></span></li>`)}</ul>`;
}

function Innovations({ of }) {
  return html`<h3>${w.innovations}</h3><ul>${Object.entries(of.before).filter(([kind]) => w.kinds[kind]).map(([kind, before]) => {
    const after = of.after[kind];
    return html`<li>${w.kinds[kind]}: ${before.toFixed(3)} → <strong>${after === undefined ? "-" : after.toFixed(3)}</strong></li>`;
  })}</ul>`;
}

export function Drive({ report, may, act, change, changing }) {
  const { survey, values } = report;
  const pending = pendingOf(survey);
  const checks = state.value?.set_up?.checks ?? [];
  const settled = may.operate && survey.recording && !survey.running;
  useEffect(() => {
    if (!settled || !report.moving) return undefined;
    const timer = setInterval(() => act("measure"), AGAIN_MS);
    return () => clearInterval(timer);
  }, [settled, report.moving]);
  const changes = Object.fromEntries(pending.flatMap((f) => Object.entries(f.changes)).map(([name, value]) => [name, JSON.stringify(value)]));
  return html`<${Instruction} report=${report} />
    <div class="toolbar"><button disabled=${!settled} onClick=${() => act("measure")}>${w.measure}</button>
      ${pending.length > 0 && html`<button disabled=${!settled} onClick=${() => act("compare")}>${w.compare}</button>`}</div>
    <p class="note" role="status">${survey.running ? (survey.comparing ? w.comparing : w.measuring) : survey.failed ? w.failed : survey.recording ? "" : w.noRecording}</p>
    ${survey.result && html`<ul class="findings">${survey.result.findings.map((row) => html`<${Finding} key=${row.quantity} row=${row} applied=${survey.applied.includes(row.quantity)} />`)}</ul>
      ${survey.result.innovations && html`<${Innovations} of=${survey.result.innovations} />`}
      ${pending.length ? html`<${Proposal} pending=${pending} values=${values} />
        <button disabled=${!may.admin || changing} onClick=${() => change(changes)}>${w.apply(pending.length)}</button>`
      : html`<p>${survey.applied.length ? w.appliedWhy : w.nothing}</p>`}`}
    ${survey.result && html`<${Certificate} may=${may} />`}
    <${Centre} name=${JSON.parse(values["vehicle.name"] ?? '""')} />
    ${checks.length > 0 && html`<details><summary>${w.checks}</summary><ul class="checks long">${checks.map((c) => html`<li><${Icon} name=${VERDICT[c.verdict]} /><span>${c.sentence || c.name.replaceAll("_", " ")}</span> <span class="dim">${w.verdicts[c.verdict]}</span></li>`)}</ul></details>`}`;
}
