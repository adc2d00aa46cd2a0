// The pages of administrators: enrolment, accounts, audit; and the own password, and toll passages.
import { useState } from "preact/hooks";
import { session } from "./unit/store.js";
import { Card, Empty, copyText, html } from "./unit/parts.js";
import { reason, send } from "./store.js";
import { Age, Problem, Table, ageS, useAsked, utc } from "./parts.js";
import { nameOf, plain, sentenceOf } from "./sentences.js";
import { w as all } from "./words.js";

// Sends a change, and keeps why it was refused.
function useChange(done) {
  const [problem, setProblem] = useState(null);
  const [busy, setBusy] = useState(false);
  const act = async (path, body) => {
    setBusy(true);
    try {
      const answer = await send(path, body);
      setProblem(null);
      await done?.(answer);
    } catch (failed) {
      setProblem(reason(failed));
    }
    setBusy(false);
  };
  return { problem, busy, act };
}

function NewToken({ vehicle: given, onMade }) {
  const w = all.enrolment;
  const [command, setCommand] = useState(null);
  const [copied, setCopied] = useState(false);
  const { problem, busy, act } = useChange((answer) => {
    setCommand(answer.command);
    setCopied(false);
    onMade();
  });
  const make = (event) => {
    event.preventDefault();
    const { vehicle, hours } = event.target.elements;
    act("api/enrolment", { vehicle: vehicle.value.trim(), hours: Number(hours.value) });
  };
  const copy = () => copyText(command).then(() => setCopied(true), () => {});
  return html`<${Card} title=${w.title} id="new-token"><form class="form" onSubmit=${make}>
      <label>${w.vehicle}<input name="vehicle" defaultValue=${given} maxlength="48" pattern="[A-Za-z0-9_\\-]*" autocapitalize="off" spellcheck="false" autocomplete="off" /><span class="note">${w.vehicleNote}</span></label>
      <label>${w.hours}<input name="hours" type="number" min="1" max="720" value="24" required /></label>
      <div class="toolbar"><button type="submit" disabled=${busy}>${w.make}</button></div></form>
    <${Problem} text=${problem} />
    <div role="status">${command && html`<h3 class="divide">${w.command}</h3><code class="command">${command}</code>
      <div class="toolbar"><button onClick=${copy}>${copied ? w.copied : w.copy}</button></div><p class="note">${w.note}</p>`}</div></${Card}>`;
}

function tokenState(token) {
  const w = all.enrolment;
  if (token.used_ms != null) return w.used(token.used_by, utc(token.used_ms));
  return ageS(token.expires_ms) > 0 ? w.expired : w.valid(utc(token.expires_ms));
}

function Withdrawable({ token, onChanged }) {
  const w = all.enrolment;
  const { problem, busy, act } = useChange(onChanged);
  if (token.used_ms != null || ageS(token.expires_ms) > 0) return null;
  return html`<button disabled=${busy} aria-label=${w.withdrawOne(token.vehicle ?? w.anyVehicle)} onClick=${() => act("api/withdraw", { token: token.id })}>${w.withdraw}</button><${Problem} text=${problem} />`;
}

function Revocable({ row, onChanged }) {
  const w = all.enrolment;
  const [sure, setSure] = useState(false);
  const [why, setWhy] = useState("");
  const [told, setTold] = useState(true);
  const { problem, busy, act } = useChange((answer) => {
    setSure(false);
    setTold(answer.told);
    onChanged();
  });
  if (row.revoked) return html`<span class="dim">${w.revoked}</span>${!told && html`<p class="note" role="status">${w.untold}</p>`}`;
  if (!sure) return html`<button onClick=${() => setSure(true)} aria-label=${w.revokeOne(row.vehicle)}>${w.revoke}</button>`;
  return html`<div class="confirm form" role="group" aria-label=${w.revokeOne(row.vehicle)}><p>${w.sure(row.vehicle)}</p>
    <label>${w.reason}<input maxlength="200" value=${why} onInput=${(e) => setWhy(e.target.value)} /></label>
    <div class="toolbar"><button disabled=${busy} onClick=${() => act("api/revoke", { vehicle: row.vehicle, reason: why })}>${w.revoke}</button><button onClick=${() => setSure(false)}>${w.cancel}</button></div><${Problem} text=${problem} /></div>`;
}

// `name`: of the vehicle, where a unit's code has led here.
export function EnrolmentPage({ name }) {
  const w = all.enrolment;
  const [find, setFind] = useState("");
  const { answer, error, again } = useAsked(`api/enrolment${find.trim() ? `?find=${encodeURIComponent(find.trim())}` : ""}`, 15000);
  return html`<div class="page admin-page"><${NewToken} vehicle=${name} onMade=${again} /><${Problem} text=${error} />
    <${Card} title=${w.vehicles} id="vehicles"><div class="toolbar filter"><input type="search" aria-label=${w.find} placeholder=${w.find} maxlength="48" value=${find} onInput=${(e) => setFind(e.target.value)} /></div>
      ${answer && (answer.vehicles.length === 0 ? html`<${Empty} title=${find.trim() ? all.map.none : w.none} />` : html`<${Table} label=${w.vehicles} columns=${w.columns}>
        ${answer.vehicles.map((row) => html`<tr key=${row.vehicle}><th scope="row"><a href=${`#/vehicles/${encodeURIComponent(row.vehicle)}`}>${row.vehicle}</a></th><td>${row.tls_until_ms == null ? w.noKey : utc(row.tls_until_ms)}</td><td>${row.evidence_keys}</td><td><${Age} ms=${row.utc_ms} /></td><td><${Revocable} row=${row} onChanged=${again} /></td></tr>`)}</${Table}>`)}
      ${answer?.more && html`<p class="note block">${all.map.more(answer.vehicles.length)}</p>`}</${Card}>
    <${Card} title=${w.tokens} id="tokens">${answer && (answer.tokens.length === 0 ? html`<p class="dim">${w.noTokens}</p>` : html`<${Table} label=${w.tokens} columns=${w.tokenColumns}>
      ${answer.tokens.map((t) => html`<tr key=${t.id}><th scope="row">${t.vehicle ?? w.anyVehicle}</th><td>${utc(t.made_ms)}</td><td>${t.made_by}</td><td>${tokenState(t)}</td><td><${Withdrawable} token=${t} onChanged=${again} /></td></tr>`)}</${Table}>`)}</${Card}></div>`;
}

export function AccountsPage() {
  const w = all.accounts;
  const { answer, error, again } = useAsked("api/accounts");
  const { problem, busy, act } = useChange(again);
  const add = (event) => {
    event.preventDefault();
    const { account, role, secret } = event.target.elements;
    act("api/accounts", { command: { action: "add", name: account.value.trim(), role: role.value, password: secret.value } });
  };
  const change = (name, what) => act("api/accounts", { command: { action: "change", name, ...what } });
  const roles = Object.keys(all.roles);
  return html`<div class="page admin-page"><${Card} title=${w.title} id="accounts"><${Problem} text=${problem ?? error} />
    ${answer && html`<${Table} label=${w.title} columns=${w.columns}>${answer.accounts.map((a) => {
      const own = a.name === session.value.name;
      return html`<tr key=${a.account_id}><th scope="row">${a.name}</th><td>${own ? a.role : html`<select aria-label=${`${w.role} ${a.name}`} value=${a.role} onChange=${(e) => change(a.name, { role: e.target.value })}>${roles.map((r) => html`<option key=${r} value=${r}>${r}</option>`)}</select>`}</td>
        <td>${utc(a.created_ms)}</td><td>${a.disabled ? w.disabled : w.active}</td><td>${own ? html`<span class="dim">${w.self}</span>` : html`<button onClick=${() => change(a.name, { disabled: !a.disabled })} aria-label=${a.disabled ? w.enableOne(a.name) : w.disableOne(a.name)}>${a.disabled ? w.enable : w.disable}</button>`}</td></tr>`;
    })}</${Table}>`}
    <dl class="rows">${roles.map((r) => html`<div class="row" key=${r}><dt>${r}</dt><dd>${all.roles[r]}</dd></div>`)}</dl></${Card}>
    <${Card} title=${w.add} id="add-account"><form class="form" onSubmit=${add}>
      <label>${w.name}<input name="account" required maxlength="80" autocapitalize="off" spellcheck="false" autocomplete="off" /></label>
      <label>${w.role}<select name="role">${roles.map((r) => html`<option key=${r} value=${r}>${r}</option>`)}</select></label>
      <label>${w.password}<input name="secret" type="password" required minlength="12" maxlength="200" autocomplete="new-password" /></label>
      <div class="toolbar"><button type="submit" disabled=${busy}>${w.add}</button></div></form></${Card}></div>`;
}

export function AccountPage() {
  const w = all.account;
  const [said, setSaid] = useState("");
  const { problem, busy, act } = useChange(() => setSaid(w.done));
  const change = (event) => {
    event.preventDefault();
    setSaid("");
    const { old, fresh } = event.target.elements;
    act("api/password", { old: old.value, new: fresh.value });
  };
  return html`<div class="page admin-page"><${Card} title=${w.title} id="password"><form class="form" onSubmit=${change}>
    <label>${w.old}<input name="old" type="password" required maxlength="200" autocomplete="current-password" /></label>
    <label>${w.fresh}<input name="fresh" type="password" required minlength="12" maxlength="200" autocomplete="new-password" /></label>
    <div class="toolbar"><button type="submit" disabled=${busy}>${w.change}</button></div><p role="status">${said}</p><${Problem} text=${problem} /></form></${Card}></div>`;
}

export function AuditPage() {
  const w = all.audit;
  const [find, setFind] = useState("");
  const [before, setBefore] = useState(null);
  const query = new URLSearchParams({ ...(find.trim() ? { find: find.trim() } : {}), ...(before ? { before: String(before) } : {}) });
  const { answer, error } = useAsked(`api/audit?${query}`, before ? 0 : 10000);
  const rows = answer?.rows ?? [];
  const failed = useAsked("api/page-errors", 10000).answer;
  return html`<div class="page admin-page"><${Card} title=${w.title} id="audit">
    ${failed?.errors > 0 && html`<p class="note block">${w.pageErrors(failed.errors, utc(failed.newest.at_ms), failed.newest.sentence)}</p>`}
    <div class="toolbar filter"><input type="search" aria-label=${w.find} placeholder=${w.find} maxlength="80" value=${find} onInput=${(e) => { setFind(e.target.value); setBefore(null); }} />
      <button disabled=${before === null} onClick=${() => setBefore(null)}>${w.newest}</button><button disabled=${!answer?.more} onClick=${() => setBefore(rows.at(-1).at_ms)}>${w.older}</button></div>
    <${Problem} text=${error} />
    ${answer && (rows.length === 0 ? html`<${Empty} title=${w.none} />` : html`<${Table} label=${w.title} columns=${w.columns}>
      ${rows.map((r, i) => html`<tr key=${i}><td>${utc(r.at_ms)}</td><td>${r.who}</td><th scope="row">${r.action}</th><td>${r.vehicle ?? ""}</td><td class="content-cell">${plain(r.detail)}</td></tr>`)}</${Table}>`)}</${Card}></div>`;
}

export function PassagesPage() {
  const w = all.passages;
  const { answer, error } = useAsked("api/passages", 10000);
  return html`<div class="page admin-page"><${Card} title=${w.title} id="passages"><${Problem} text=${error} />
    ${answer && (answer.passages.length === 0 ? html`<${Empty} title=${w.none} why=${w.noneWhy} />` : html`<${Table} label=${w.title} columns=${w.columns}>
      ${answer.passages.map((p, i) => html`<tr key=${i}><td>${utc(p.utc_ms)}</td><th scope="row">${p.vehicle}</th><td>${nameOf(p.name)}</td><td class="content-cell">${sentenceOf(p.name, p)}</td></tr>`)}</${Table}>`)}</${Card}></div>`;
}
