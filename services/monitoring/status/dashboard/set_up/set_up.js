// The set-up of the unit, step by step: each is measured, or confirmed; the unit keeps how far it is.
import { useEffect, useState } from "preact/hooks";
import { change as post, link, session, settings } from "../store.js";
import { Card, Empty, Icon, duration, html } from "../parts.js";
import { words } from "../words.js";
import { Drive } from "./drive.js";
import { Antenna, Bubble, MountedUnit } from "./pictures.js";
import { setUpWords as w } from "./set_up_words.js";

const PERIOD_MS = 1000, FAST_MS = 400;
const ANSWER_MS = 90000; // a slow computer takes as long to load the models of all processes
const STEP_STATE = { not_done: "off", measuring: "initialising", agrees: "safe", contradicts: "caution" };
const LENGTHS = { cm: 0.01, in: 0.0254 };
const SEEN = { working: "safe", silent: "off" };

const json = async (path) => {
  const answer = await fetch(path, { signal: AbortSignal.timeout(5000) });
  if (!answer.ok) throw new Error(String(answer.status));
  return answer.json();
};

function useReport(step) {
  const [report, setReport] = useState(null);
  useEffect(() => {
    const look = () => json(`api/set-up?step=${step}`).then(setReport, () => {}); // a lost connection is said by the bar above
    look();
    const timer = setInterval(look, step === "imu" ? FAST_MS : PERIOD_MS);
    return () => clearInterval(timer);
  }, [step, link.value.open]);
  return report;
}

// A change of settings, from the request to what has become of it.
function useChange() {
  const [open, setOpen] = useState(null);
  useEffect(() => {
    if (!open?.id || open.stage !== "checked") return undefined;
    const timer = setInterval(async () => {
      const report = await json("api/settings").catch(() => null);
      const done = [report?.state?.change, report?.answer].find((one) => one?.request_id === open.id && one.stage !== "checked");
      if (done) setOpen({ ...open, stage: done.stage, why: [...report.refusals, ...report.reasons].join("; "), offered: done.offered });
      else if (performance.now() - open.sent > ANSWER_MS) setOpen({ ...open, stage: "refused", why: "" });
    }, PERIOD_MS);
    return () => clearInterval(timer);
  }, [open]);
  const run = async (changes) => {
    const sent = performance.now();
    setOpen({ stage: "checked", sent });
    const answer = await post("api/settings", changes ? { action: "apply", changes } : { action: "take_back" }).catch(() => null);
    const body = answer && (await answer.json());
    if (!answer?.ok) setOpen({ stage: "refused", sent, why: typeof body?.detail === "string" ? body.detail : "" });
    else setOpen({ stage: changes ? "checked" : "taken_back", sent, id: body.request_id, why: "" });
  };
  return [open, run];
}

function Changed({ open, run }) {
  if (!open) return null;
  const text = open.stage === "checked" ? w.waiting : w.change[open.stage];
  return html`<p class="note block" role="status">${text}${open.why && `: ${open.why}`}
    ${["watched", "kept"].includes(open.stage) && html` <button onClick=${() => run(null)}>${w.takeBack}</button>`}</p>`;
}

// What a set changes here: processes that begin or end, its settings, and those of another set, which go back.
function changesOf(set, sets, values) {
  const others = sets.filter((other) => other !== set).flatMap((other) => Object.entries(other.settings));
  const left = others.filter(([name, value]) => !(name in set.settings) && values[name] === value && set.runs[name.split(".").slice(0, 2).join(".")] !== false);
  const switched = Object.entries(set.runs).filter(([name, runs]) => (values[name] === "true") !== runs);
  const own = Object.entries(set.settings).filter(([name, value]) => values[name] !== value);
  return Object.fromEntries([...left.map(([name]) => [name, null]), ...switched.map(([name, runs]) => [name, String(runs)]), ...own]);
}

function Sets({ report, may, change, changing }) {
  const { sets, values } = report;
  if (!sets.length || !("vehicle.name" in values)) return null; // controller.settings has just started
  return html`<h3>${w.sets}</h3><ul class="sets">${sets.map((set) => {
    const changes = changesOf(set, sets, values);
    return html`<li key=${set.name}><p><strong>${w.setNames[set.name] ?? set.what}</strong></p>
      ${!Object.keys(changes).length ? html`<span>${w.chosen}</span>` : html`<button disabled=${!may.admin || changing} onClick=${() => change(changes)} aria-label=${`${w.choose}: ${w.setNames[set.name] ?? set.what}`}>${w.choose}</button>`}</li>`;
  })}</ul>`;
}

function Unit({ report, may, act, change, changing }) {
  const present = JSON.parse(report.values["vehicle.name"] ?? '""');
  const [name, setName] = useState(null);
  return html`<label>${w.name} <input type="text" value=${name ?? present} maxlength="48" spellcheck="false" disabled=${!may.admin} onInput=${(e) => setName(e.target.value)} /></label>
    ${name !== null && name !== present && html`<button disabled=${!may.admin} onClick=${() => change({ "vehicle.name": JSON.stringify(name) })}>${w.save}</button>`}
    <${Sets} report=${report} may=${may} change=${change} changing=${changing} /><p class="note">${w.units}</p>
    <button disabled=${!may.operate} onClick=${() => act("confirm", "unit")}>${w.confirm}</button>`;
}

function Devices({ report }) {
  if (!report.devices.length) return html`<p>${w.noDevices}</p>`;
  return html`<ul class="checks long">${report.devices.map((d) => html`<li key=${d.topic}><${Icon} name=${d.fresh ? "safe" : d.age_s === null ? SEEN.silent : "caution"} />
    <span>${d.process} <span class="dim">${d.port?.device ?? d.topic}</span></span>
    <span>${d.fresh ? w.rate(d.rate_hz) : d.age_s === null ? w.silent : w.lost(duration(d.age_s))}</span>
    ${(d.port?.protocols?.length > 0 || d.kinds.length > 0) && html`<span class="dim">${w.recognised}: ${[...(d.port?.protocols ?? []), ...d.kinds].join(", ")}</span>`}
    ${d.port?.sentence && html`<span class="dim">${d.port.sentence}</span>`}</li>`)}</ul>`;
}

function Receiver({ report: { receiver } }) {
  if (!receiver) return html`<p>${w.receiverNone}</p>`;
  const facts = [receiver.model, receiver.protocol, receiver.firmware, receiver.dynamic_model, (receiver.messages ?? []).join(", ")].filter(Boolean);
  return html`${"accepted" in receiver && html`<p>${receiver.accepted ? w.receiverAccepted : `${w.receiverRefused}: ${receiver.reason ?? ""}`}</p>`}
    <ul>${facts.map((fact) => html`<li>${fact}</li>`)}</ul>`;
}

function Corrections({ report: { corrections } }) {
  if (!corrections) return html`<p>${w.correctionsNone}</p>`;
  if (corrections.active === null) return html`<p>${w.correctionsWaiting}</p>`;
  return html`<p>${w.correctionsActive(corrections.active, corrections.frame_age_s === null ? "-" : duration(corrections.frame_age_s))}</p>
    <p class="dim">${words.position.carrier[corrections.carrier] ?? ""}</p>`;
}

function Imu({ report, may, change }) {
  const { level, values } = report;
  const matrix = JSON.parse(values["vehicle.imu.body_from_sensor"] ?? "null");
  const present = JSON.parse(values["core.spoofing.grade"] ?? "null");
  return html`<h3>${w.believed}</h3>${matrix && html`<${MountedUnit} matrix=${matrix} />`}
    ${!level ? html`<p>${w.noImu}</p>` : html`<${Bubble} level=${level} />
      ${level.grade === null ? html`<p>${w.notStill} (${level.seconds} s)</p>` : html`<p>${w.gyroscope}: ${(level.rate_noise * 180 / Math.PI * 60).toPrecision(2)} °/√h, ${w.accelerometer}: ${(level.force_noise * 60).toPrecision(2)} m/s/√h <span class="dim">(${w.noiseOf(level.seconds)})</span></p>
        <p>${w.grade}: <strong>${level.grade}</strong></p>
        ${level.grade !== present && html`<button disabled=${!may.admin} onClick=${() => change({ "core.spoofing.grade": JSON.stringify(level.grade) })}>${w.useGrade(level.grade)}</button>`}`}`}`;
}

const read = (text) => (/^\s*[-+]?\d+([.,]\d+)?\s*$/.test(text) ? Number(text.replace(",", ".")) : NaN);

function AntennaStep({ report, may, act, change }) {
  const [unit, setUnit] = useState(settings.value.length === "ft" ? "in" : "cm");
  const [typed, setTyped] = useState(null);
  const present = JSON.parse(report.values["vehicle.gnss.lever_arm_body_m"] ?? "[0,0,0]");
  const sd = JSON.parse(report.values["vehicle.gnss.lever_arm_sd_m"] ?? "null");
  const text = (value) => String(Number((value / LENGTHS[unit]).toFixed(2)));
  const fields = typed ?? [...present.map(text), sd === null ? "" : text(sd)];
  const metres = fields.map((one) => read(one) * LENGTHS[unit]);
  const arm = metres.slice(0, 3);
  const whole = arm.every((value) => Number.isFinite(value) && Math.abs(value) < 50) && (fields[3].trim() === "" || metres[3] >= 0);
  const edit = (place) => (event) => setTyped(fields.map((one, k) => (k === place ? event.target.value : one)));
  const apply = () => {
    const rounded = arm.map((value) => Number(value.toFixed(4)));
    change({ "vehicle.gnss.lever_arm_body_m": JSON.stringify(rounded), ...(fields[3].trim() && { "vehicle.gnss.lever_arm_sd_m": JSON.stringify(Number(metres[3].toFixed(4))) }) });
    setTyped(null);
  };
  return html`<p class="note">${w.antennaWhy}</p><${Antenna} arm=${whole ? arm : present} />
    <div class="arm-fields">${[...w.fields, w.sd].map((name, k) => html`<label key=${name}>${name} [${unit}] <input type="text" inputmode="text" value=${fields[k]} disabled=${!may.admin} onInput=${edit(k)} /></label>`)}
      <label>${w.unit} <select value=${unit} onChange=${(e) => { setUnit(e.target.value); setTyped(null); }}>${Object.keys(LENGTHS).map((name) => html`<option value=${name}>${name}</option>`)}</select></label></div>
    <div class="toolbar">${typed && html`<button disabled=${!may.admin || !whole} onClick=${apply}>${w.save}</button><button onClick=${() => setTyped(null)}>${w.reset}</button>`}
      ${!typed && html`<button disabled=${!may.operate} onClick=${() => act("confirm", "antenna")}>${w.confirm}</button>`}</div>`;
}

function Bus({ report: { signals } }) {
  if (!signals.length) return html`<p>${w.busNone}</p>`;
  return html`<p class="note">${w.busWhy}</p><ol class="checks long">${signals.map((s) => html`<li key=${s.topic}><code>${s.topic}</code> <span>${w.rate(s.rate_hz)}</span>
    ${s.ratio !== null && html`<span>${(100 * s.ratio).toFixed(1)} % ${w.ratio}, ${w.correlation} ${s.correlation ?? "-"}</span>`}</li>`)}</ol>`;
}

const STEPS = { unit: Unit, devices: Devices, receiver: Receiver, corrections: Corrections, imu: Imu, antenna: AntennaStep, bus: Bus, drive: Drive };

export function SetUpPage({ query, go }) {
  const [chosen, setChosen] = useState(query.get("step"));
  const [wanted, setWanted] = useState("");
  const report = useReport(wanted);
  const [open, run] = useChange();
  const step = report?.moving ? "drive" : chosen in STEPS ? chosen : report?.steps.find((s) => s.state !== "agrees")?.name ?? "drive";
  useEffect(() => {
    if (report) setWanted(step);
  }, [step, Boolean(report)]);
  if (!report) return html`<p class="boot">${words.connecting}</p>`;
  const role = session.value?.role;
  const may = { admin: role === "admin" && link.value.open, operate: ["admin", "operator"].includes(role) && link.value.open };
  const act = (action, name = "") => post("api/set-up", { action, step: name }).catch(() => {});
  const toggle = (name) => (event) => {
    event.preventDefault();
    setChosen(name);
    go(`#/set_up?step=${name}`);
  };
  const shown = report.steps.filter((s) => !report.moving || s.name === "drive");
  if (!shown.length) return html`<${Empty} title=${w.silentPage} />`;
  return html`<div class="settings-page set-up-page" lang=${document.documentElement.lang}><${Card} title=${w.title} note=${w.note} id="set-up">
    ${report.moving && html`<p class="note block" role="status">${w.moving}</p>`}
    ${!may.admin && html`<p class="note block">${w.needsAdmin}</p>`}
    <${Changed} open=${open} run=${run} />
    ${shown.map(({ name, state: now, confirmed_ns: confirmed }) => {
      const Step = STEPS[name];
      return html`<details key=${name} class="settings-section" open=${name === step}><summary onClick=${toggle(name)}><${Icon} name=${STEP_STATE[now]} /><strong>${w.steps[name]}</strong>
        <span class="dim">${w.states[now]}${confirmed !== null && `, ${w.confirmed}`}</span></summary>
        ${name === step && html`<${Step} report=${report} may=${may} act=${act} change=${run} changing=${open?.stage === "checked"} />`}</details>`;
    })}
  </${Card}></div>`;
}
