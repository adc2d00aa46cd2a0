// Every setting of the unit: seen, changed, checked before it is written, watched after it, and taken back.
import { useEffect, useState } from "preact/hooks";
import { change, link, session } from "../store.js";
import { Card, Empty, Icon, dayOf, duration, html, timeOfDay } from "../parts.js";
import { words } from "../words.js";
import { settingsWords as w } from "./settings_words.js";

const PERIOD_MS = 1000;
const ANSWER_MS = 90000; // a slow computer takes as long to load the models of all processes

async function read() {
  const answer = await fetch("api/settings", { signal: AbortSignal.timeout(5000) });
  if (!answer.ok) throw new Error(String(answer.status));
  return answer.json();
}

async function send(command) {
  const answer = await change("api/settings", command);
  const body = await answer.json();
  if (!answer.ok) throw new Error(typeof body.detail === "string" ? body.detail : w.noAnswer);
  return body.request_id;
}

function useReport() {
  const [report, setReport] = useState(null);
  useEffect(() => {
    const look = () => read().then(setReport, () => {}); // a lost connection is said by the bar above
    look();
    const timer = setInterval(look, PERIOD_MS);
    return () => clearInterval(timer);
  }, [link.value.open]);
  return report;
}

// The command in progress, and what has become of it.
function useCommand(report) {
  const [open, setOpen] = useState(null);
  const run = async (command) => {
    setOpen({ action: command.action, sent: performance.now() });
    try {
      const id = await send(command);
      setOpen((now) => ({ ...now, id }));
    } catch (error) {
      setOpen((now) => ({ ...now, error: error.name === "TimeoutError" ? w.noAnswer : error.message }));
    }
  };
  const id = open?.id;
  const found = id && report?.answer?.request_id === id ? report.answer : null;
  const settled = Boolean(id) && (report?.state?.change?.request_id === id || ["confirm", "take_back"].includes(open.action));
  const late = open && !open.error && !found && !settled && performance.now() - open.sent > ANSWER_MS;
  return [run, open && { ...open, error: late ? w.noAnswer : open.error, answer: found, settled }, () => setOpen(null)];
}

const types = (row) => row.kind.split(" or ");
const isText = (row) => types(row).includes("string") && !types(row).some((type) => ["array", "object", "table"].includes(type));
const isNumber = (row) => types(row).some((type) => ["number", "integer"].includes(type)) && !isText(row);
const isChoice = (row) => row.choices.length > 0 || (types(row).includes("boolean") && !isText(row));
const shown = (text) => ({ null: w.notSet, true: w.yes, false: w.no })[text] ?? text;

// What stands in the field for a value of JSON, and the value of JSON for what stands in the field.
function fieldOf(row, value) {
  if (value === "null") return "";
  try {
    return (isText(row) || row.choices.length > 0) && value.startsWith('"') ? JSON.parse(value) : value;
  } catch {
    return value;
  }
}

function valueOf(row, field) {
  if (field === null) return null;
  if (field === "") return isText(row) && !types(row).includes("null") ? '""' : null;
  if (isNumber(row)) return Number.isFinite(Number(field)) ? String(Number(field)) : field;
  if (!isText(row) && !row.choices.length) return field;
  const mayBeOther = types(row).some((type) => !["string", "null"].includes(type));
  return mayBeOther && /^(true|false|-?\d+(\.\d+)?)$/.test(field) ? field : JSON.stringify(field);
}

function Field({ row, field, edit, disabled }) {
  const common = { id: `setting-${row.name}`, disabled, value: field };
  const changed = (event) => edit(event.target.value);
  if (isChoice(row)) {
    const options = row.choices.length ? row.choices : ["true", "false"];
    return html`<select ...${common} onChange=${changed}>
      ${types(row).includes("null") && html`<option value="">${w.notSet}</option>`}
      ${options.map((one) => html`<option value=${one}>${shown(one)}</option>`)}</select>`;
  }
  if (isNumber(row)) return html`<input type="number" step="any" inputmode="decimal" ...${common} onInput=${changed} />`;
  return html`<input type="text" spellcheck="false" autocapitalize="off" ...${common} onInput=${changed} />`;
}

function SettingRow({ row, edited, edit, disabled }) {
  // What is being typed stays as it is: it becomes a value when it is checked. null: the default.
  const field = edited[row.name] ?? fieldOf(row, row.name in edited ? row.default : row.value);
  const key = row.name.split(".").slice(row.name.startsWith("vehicle.") ? 1 : 2).join(" ");
  const plain = isText(row) || isNumber(row) || isChoice(row);
  const facts = [...(plain ? [] : [w.list]), ...row.bounds, w.default(shown(row.default))];
  return html`<li class="setting ${row.name in edited ? "edited" : ""}">
    <label for=${`setting-${row.name}`}>${key.replaceAll("_", " ") || w.runs}</label>
    <${Field} row=${row} field=${field} edit=${(text) => edit(row, text)} disabled=${disabled} />
    <p class="note">${row.meaning} <span class="dim">(${facts.join(", ")})</span>
      ${field !== fieldOf(row, row.default) && !disabled && html` <button onClick=${() => edit(row, null)} aria-label=${w.useDefaultOf(row.name)}>${w.useDefault}</button>`}</p>
  </li>`;
}

function Section({ name, rows, edited, edit, open, disabled }) {
  const differing = rows.filter((row) => row.value !== row.default).length;
  return html`<details class="settings-section" open=${open}><summary><strong>${w.sections[name] ?? name}</strong>
    <span class="dim">${w.count(rows.length)}${differing > 0 && `, ${w.differing(differing)}`}</span></summary>
    <ul class="settings-list">${rows.map((row) => html`<${SettingRow} key=${row.name} row=${row} edited=${edited} edit=${edit} disabled=${disabled} />`)}</ul>
  </details>`;
}

const Differences = ({ of, asked }) => html`<ul class="differences">${of.differences.map((d) => html`<li key=${d.name}><code>${d.name}</code>
  <span> ${shown(d.before)} → <strong>${shown(d.after)}</strong></span>${asked && !(d.name in asked) && html` <span class="dim">${w.follows}</span>`}</li>`)}</ul>`;

function Newest({ report, run, may }) {
  const one = report.state.change;
  if (!one) return null;
  const leftS = one.until_ns ? Math.max(0, (one.until_ns - report.now_ns) / 1e9) : null;
  const icon = { watched: "caution", kept: "safe", taken_back: "unsafe" }[one.stage] ?? "off";
  return html`<${Card} title=${w.stages[one.stage]} note=${w.by(one.by, timeOfDay(one.begun_ns / 1e6))} id="newest-change" class="newest-change">
    <p><${Icon} name=${icon} /> ${leftS !== null && w.left(duration(leftS))} <span role="status">${report.reasons.join("; ")}</span></p>
    <${Differences} of=${one} />
    ${one.stage === "watched" && one.confirmation && html`<p>${w.confirmWhy}</p>`}
    ${one.stage === "kept" && one.offered && html`<p>${w.offered}</p>`}
    ${may && html`<div class="toolbar">${one.stage === "watched" && one.confirmation && html`<button onClick=${() => run({ action: "confirm" })}>${w.confirm}</button>`}
      ${["watched", "kept"].includes(one.stage) && html`<button onClick=${() => run({ action: "take_back" })}>${w.takeBack}</button>`}</div>`}
  </${Card}>`;
}

function Versions({ state, run, may }) {
  const dated = (ns) => `${dayOf(ns / 1e6)} ${timeOfDay(ns / 1e6)}`;
  return html`<details class="settings-section"><summary><strong>${w.versions}</strong> <span class="dim">${state.versions.length}</span></summary>
    <p class="note">${state.changed ? w.changedNote : w.fileNote}</p>
    ${!state.versions.length ? html`<p class="note">${w.noVersions}</p>` : html`<ul class="versions">${state.versions.map((v) => html`<li key=${v.replaced_ns}>
      <span>${w.version(dated(v.replaced_ns), v.differing)}</span>
      ${may && html`<button onClick=${() => run({ action: "restore", version: v.number })} aria-label=${w.restoreOf(v.number)}>${w.restore}</button>`}</li>`)}</ul>`}
  </details>`;
}

// What is edited: the values, what they would change once that is known, and the way on.
function Pending({ changes, checked, waiting, may, run, discard }) {
  const count = Object.keys(changes).length;
  if (!count) return null;
  const step = checked ? ["apply", w.apply] : ["check", w.check];
  return html`<div class="pending" role="group" aria-label=${w.edited(count)}><p><strong>${w.edited(count)}</strong></p>
    ${checked && html`<h3>${w.wouldChange}</h3><${Differences} of=${checked} asked=${changes} /><p>${w.restarts(checked.touched)} ${w.watchedFor}</p>`}
    <div class="toolbar"><button disabled=${!may || waiting} onClick=${() => run({ action: step[0], changes })}>${step[1]}</button>
      <button onClick=${discard}>${w.discard}</button></div></div>`;
}

function grouped(rows) {
  const found = new Map();
  for (const row of rows) {
    const name = row.name.startsWith("vehicle.") ? "vehicle" : row.name.split(".").slice(0, 2).join(".");
    found.set(name, [...(found.get(name) ?? []), row]);
  }
  return [...found];
}

export function SettingsPage() {
  const report = useReport();
  const [run, open, forget] = useCommand(report);
  const [edited, setEdited] = useState({});
  const [search, setSearch] = useState("");
  const [only, setOnly] = useState(false);
  const applied = open?.action === "apply" && open.settled;
  const discard = () => { setEdited({}); forget(); };
  useEffect(() => {
    if (applied) discard();
  }, [applied]);
  if (!report) return html`<p class="boot">${words.connecting}</p>`;
  const empty = !report.alive ? [w.down, w.downWhy] : !report.state || !report.settings.length ? [w.silent, report.problem ?? w.silentWhy] : null;
  if (empty) return html`<${Card} title=${w.title} id="settings"><${Empty} title=${empty[0]} why=${empty[1]} /></${Card}>`;
  const may = session.value?.role === "admin" && link.value.open;
  const edit = (row, value) => {
    const next = { ...edited, [row.name]: value };
    if (value === null ? row.value === row.default : value === fieldOf(row, row.value)) delete next[row.name];
    setEdited(next);
    forget();
  };
  const changes = Object.fromEntries(report.settings.filter((row) => row.name in edited).map((row) => [row.name, valueOf(row, edited[row.name])]));
  const wanted = search.trim().toLowerCase();
  const matches = (row) => `${row.name} ${row.name.replaceAll("_", " ")} ${row.meaning}`.toLowerCase().includes(wanted);
  const rows = report.settings.filter((row) => matches(row) && (!only || row.value !== row.default || row.name in edited));
  const refused = open?.answer?.stage === "refused" ? `${w.refused}: ${report.refusals.join("; ")}` : "";
  const checked = open?.action === "check" && open.answer?.stage === "checked" ? open.answer : null;
  const waiting = Boolean(open) && !open.error && !open.answer && !open.settled;
  const narrowed = Boolean(wanted) || only;
  return html`<div class="settings-page"><${Newest} report=${report} run=${run} may=${may} />
    <${Card} title=${w.title} note=${w.note} id="settings" aside=${html`<a href="#/set_up">${words.pages.set_up}</a>`}>
      ${report.problem && html`<p class="note block" role="alert">${report.problem}</p>`}
      ${!may && html`<p class="note block">${w.needsAdmin}</p>`}
      <div class="settings-tools"><label><span>${w.search}</span><input type="search" value=${search} onInput=${(e) => setSearch(e.target.value)} /></label>
        <label class="switch"><input type="checkbox" checked=${only} onChange=${(e) => setOnly(e.target.checked)} /> ${w.onlyChanged}</label></div>
      <${Pending} changes=${changes} checked=${checked} waiting=${waiting} may=${may} run=${run} discard=${discard} />
      <p role="status" class="note">${waiting ? w.checking : open?.error ?? refused}</p>
      ${!rows.length && html`<p class="note block">${w.nothingFound}</p>`}
      ${grouped(rows).map(([name, some]) => html`<${Section} key=${`${name} ${narrowed}`} name=${name} rows=${some} edited=${edited} edit=${edit} open=${narrowed} disabled=${!may} />`)}
      <${Versions} state=${report.state} run=${run} may=${may} />
    </${Card}></div>`;
}
