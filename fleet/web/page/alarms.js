// The page Alarms: what is open, since when, who has acknowledged it; and the tenant's web hook.
import { useEffect, useState } from "preact/hooks";
import { Card, Empty, duration, html } from "./unit/parts.js";
import { may, onFrame, reason, send } from "./store.js";
import { Problem, Table, ageS, useAsked, utc } from "./parts.js";
import { alarmSentence } from "./sentences.js";
import { w as all } from "./words.js";

const w = all.alarms;
const EVERY_MS = 10000;

function Hook() {
  const { answer, error } = useAsked("api/web-hook");
  const [address, setAddress] = useState(null);
  const [stored, setStored] = useState(null);
  const [said, setSaid] = useState(null);
  const [problem, setProblem] = useState(null);
  const save = async (event) => {
    event.preventDefault();
    setSaid(null);
    try {
      setStored(await send("api/web-hook", { address: (address ?? answer?.address ?? "").trim() }));
      setProblem(null);
      setSaid(w.saved);
    } catch (failed) {
      setProblem(reason(failed));
    }
  };
  const secret = (stored ?? answer)?.secret;
  return html`<${Card} title=${w.hook} id="hook"><p class="note">${w.hookNote}</p><form class="form" onSubmit=${save}>
    <label>${w.hookLabel}<input type="url" maxlength="500" value=${address ?? answer?.address ?? ""} onInput=${(e) => setAddress(e.target.value)} /></label>
    ${secret && html`<label>${w.hookSecret}<input readonly value=${secret} onFocus=${(e) => e.target.select()} /></label>`}
    <div class="toolbar"><button type="submit">${w.save}</button><span role="status">${said ?? ""}</span></div><${Problem} text=${problem ?? error} /></form></${Card}>`;
}

function Alarm({ row, onAcknowledge }) {
  const kind = w.kinds[row.kind];
  const { last_ms: last, ...detail } = row.detail;
  return html`<tr><th scope="row"><a href=${`#/vehicles/${encodeURIComponent(row.vehicle)}`}>${row.vehicle}</a></th>
    <td>${kind}${row.late && html` <span class="old-mark" title=${w.lateTitle}>${w.late}</span>`}${Object.keys(detail).length > 0 && html`<span class="note block">${alarmSentence(row, detail)}${last != null && ` ${w.last(utc(last))}`}</span>`}</td>
    <td>${utc(row.since_ms)} <span class="dim">${all.ago(duration(ageS(row.since_ms)))}</span></td>
    <td>${row.until_ms == null ? html`<strong>${w.open}</strong>` : utc(row.until_ms)}</td>
    <td>${row.acknowledged_ms != null ? w.by(row.acknowledged_by, utc(row.acknowledged_ms))
      : may("operate") ? html`<button onClick=${() => onAcknowledge(row)} aria-label=${w.acknowledgeOne(kind, row.vehicle)}>${w.acknowledge}</button>` : all.unknown}</td></tr>`;
}

export function AlarmsPage() {
  const [show, setShow] = useState("open");
  const [kind, setKind] = useState("any");
  const [problem, setProblem] = useState(null);
  const { answer, error, again } = useAsked(`api/alarms?show=${show}&kind=${kind}`, EVERY_MS);
  useEffect(() => onFrame((frame) => (frame.many || frame.alarms.length) && again()), [show, kind]);
  const acknowledge = async (row) => {
    try {
      await send(`api/alarms/${row.alarm_id}/acknowledge`, {});
      setProblem(null);
    } catch (failed) {
      setProblem(reason(failed));
    }
    again();
  };
  return html`<div class="page admin-page"><${Card} title=${w.title} id="alarms">
    <div class="toolbar filter"><select aria-label=${w.show} value=${show} onChange=${(e) => setShow(e.target.value)}>${Object.entries(w.filters).map(([key, text]) => html`<option key=${key} value=${key}>${text}</option>`)}</select>
      <select aria-label=${w.kind} value=${kind} onChange=${(e) => setKind(e.target.value)}><option value="any">${w.anyKind}</option>${Object.entries(w.kinds).map(([key, text]) => html`<option key=${key} value=${key}>${text}</option>`)}</select></div>
    <${Problem} text=${problem ?? error} />
    ${answer && (answer.alarms.length === 0 ? html`<${Empty} title=${w.none} why=${w.noneWhy} />`
      : html`<${Table} label=${w.title} columns=${w.columns}>${answer.alarms.map((row) => html`<${Alarm} key=${row.alarm_id} row=${row} onAcknowledge=${acknowledge} />`)}</${Table}>`)}
    ${answer?.more && html`<p class="note block">${w.more(answer.alarms.length)}</p>`}</${Card}>
    ${may("admin") && html`<${Hook} />`}</div>`;
}
