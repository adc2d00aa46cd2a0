// The card of a simulated unit on the page Trust: starts and stops attacks, and compares the verdict with the truth.
import { useEffect, useState } from "preact/hooks";
import { change, link, nowMs, state } from "../store.js";
import { Card, Row, StateIcon, duration, html, metres, timeOfDay } from "../parts.js";
import { words } from "../words.js";

const w = words.attacks;
const ANSWER_MS = 5000;

async function send(command) {
  const answer = await change("api/simulation/attack", command);
  const body = await answer.json();
  if (!answer.ok) throw new Error(typeof body.detail === "string" ? body.detail : w.failed(answer.status));
  return body.request_id;
}

function useCatalogue() {
  const [rows, setRows] = useState([]);
  useEffect(() => {
    if (rows.length || !link.value.open) return;
    fetch("api/simulation", { signal: AbortSignal.timeout(ANSWER_MS) })
      .then((answer) => answer.json())
      .then((body) => setRows(body.attacks))
      .catch(() => setRows([])); // the connection is lost, which the bar above says; opened again, it is asked again
  }, [link.value.open]);
  return rows;
}

// What has become of the last command: sent, executed, refused, or without an answer.
function useCommand() {
  const [last, setLast] = useState(null); // { id, sentAt, error }
  const simulation = state.value.simulation;
  const run = async (command) => {
    setLast({ id: null, sentAt: performance.now(), error: null });
    try {
      const id = await send(command);
      setLast({ id, sentAt: performance.now(), error: null });
    } catch (error) {
      setLast({ id: null, sentAt: performance.now(), error: error.name === "TimeoutError" ? w.noAnswer : error.message });
    }
  };
  let text = "";
  if (last?.error) text = w.refused(last.error);
  else if (last?.id && simulation.request_id === last.id) text = simulation.refused ? w.refused(simulation.refused) : w.done;
  else if (last) text = performance.now() - last.sentAt > ANSWER_MS ? w.noAnswer : w.sent;
  return [run, text];
}

const agoText = (ns) => (nowMs() === null ? "" : duration(Math.max(0, (nowMs() - ns / 1e6) / 1000)));
const parametersText = (run) => Object.entries(run.parameters).map(([name, value]) => `${name} ${Number(value.toPrecision(4))}`).join(", ");
const labelOf = (name) => name.replaceAll("_", " ");

function StartForm({ rows, run, text }) {
  const [name, setName] = useState("drag_off");
  const [values, setValues] = useState({});
  const row = rows.find((one) => one.name === name);
  if (!row) return html`<p class="note block">${w.loading}</p>`;
  const submit = (event) => {
    event.preventDefault();
    const { duration_s, ...rest } = values;
    const parameters = Object.fromEntries(Object.entries(rest).filter(([, value]) => value !== "").map(([key, value]) => [key, Number(value)]));
    run({ command: "start", attack: name, parameters, duration_s: duration_s ? Number(duration_s) : null });
  };
  const field = (key, label, unit, more) => html`<label key=${`${name}-${key}`}><span>${label}${unit && html` <span class="dim">${unit}</span>`}</span>
    <input type="number" step="any" value=${values[key] ?? ""} onInput=${(e) => setValues({ ...values, [key]: e.target.value })} ...${more} /></label>`;
  return html`<form class="attack-form" onSubmit=${submit}>
    <label class="attack-name"><span>${w.attack}</span><select value=${name} onChange=${(e) => { setName(e.target.value); setValues({}); }}>
      ${rows.map((one) => html`<option value=${one.name}>${one.label}</option>`)}</select></label>
    <p class="note block">${row.purpose[0].toUpperCase() + row.purpose.slice(1)}.</p>
    <div class="attack-fields">${row.parameters.map((p) => field(p.name, p.name, p.unit, { min: p.least, max: p.greatest, placeholder: String(p.default), title: p.purpose }))}
      ${field("duration_s", w.duration, "s", { min: 0.1, max: 86400, placeholder: w.untilStopped })}</div>
    <div class="toolbar"><button type="submit" disabled=${!link.value.open}>${w.start(row.label)}</button><span class="note" role="status">${text}</span></div>
  </form>`;
}

function AttackList({ runs, run }) {
  const active = runs.filter((one) => one.ended_ns === null);
  const ended = runs.filter((one) => one.ended_ns !== null).slice(-5).reverse();
  return html`<div><h3>${w.active}</h3>
    ${!active.length ? html`<p class="note block">${w.none}</p>` : html`<ul class="attack-list">${active.map((one) => html`<li key=${one.started_ns + one.attack}>
      <span><strong>${labelOf(one.attack)}</strong> <span class="dim">${w.since(timeOfDay(one.started_ns / 1e6), agoText(one.started_ns))}${parametersText(one) && `, ${parametersText(one)}`}</span></span>
      <button onClick=${() => run({ command: "stop", attack: one.attack })} aria-label=${w.stopOne(labelOf(one.attack))}>${w.stop}</button></li>`)}</ul>`}
    ${active.length > 1 && html`<p class="toolbar"><button onClick=${() => run({ command: "stop" })}>${w.stopAll}</button></p>`}
    ${ended.length > 0 && html`<p class="note block">${w.ended(ended.map((one) => w.span(labelOf(one.attack), timeOfDay(one.started_ns / 1e6), duration((one.ended_ns - one.started_ns) / 1e9))).join("; "))}</p>`}
  </div>`;
}

// Three answers: right, SAFE although the error is above the limit, alarm although it is within.
function judgement(s) {
  if (s.above === null || s.verdict === null) return ["off", w.notComparable];
  if (s.above) return s.verdict === "safe" ? ["unsafe", w.misleading] : ["safe", w.rightlyDenied(words.trust[s.verdict])];
  return s.verdict === "safe" ? ["safe", w.rightlySafe] : ["info", w.cautious(words.trust[s.verdict])];
}

function Truth({ s, limits }) {
  const [icon, text] = judgement(s);
  const rows = Object.entries(s.seconds).filter(([, t]) => t.within + t.above > 0);
  return html`<div><h3>${w.truth}</h3>
    <p class="right-or-wrong"><${StateIcon} state=${icon} word="" /><strong>${text}</strong></p>
    <dl class="rows">
      <${Row} label=${w.horizontal} value=${metres(s.error_horizontal_m)} extra=${limits && words.trustPage.alertLimit(metres(limits.alert_limit_horizontal_m))} />
      <${Row} label=${w.vertical} value=${metres(s.error_vertical_m)} extra=${limits && words.trustPage.alertLimit(metres(limits.alert_limit_vertical_m))} />
    </dl>
    ${rows.length > 0 && html`<table class="plain"><thead><tr><th scope="col">${w.verdict}</th><th scope="col">${w.within}</th><th scope="col">${w.above}</th></tr></thead>
      <tbody>${rows.map(([name, t]) => html`<tr key=${name}><th scope="row">${words.trust[name]}</th><td>${duration(t.within)}</td>
        <td class=${name === "safe" && t.above > 0 ? "misleading" : ""}>${duration(t.above)}</td></tr>`)}</tbody></table>
    <p class="note block">${w.secondsNote}</p>`}
  </div>`;
}

export function AttacksCard() {
  const rows = useCatalogue();
  const [run, text] = useCommand();
  const s = state.value.simulation;
  return html`<${Card} title=${w.title} note=${w.note} id="attacks" fold class="attacks-card">
    <div class="attack-columns"><${StartForm} rows=${rows} run=${run} text=${text} /><${AttackList} runs=${s.attacks} run=${run} /><${Truth} s=${s} limits=${state.value.trust.verdict} /></div>
  </${Card}>`;
}
