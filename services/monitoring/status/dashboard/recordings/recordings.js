// The recordings of the unit: outline, length, verdicts and outages of each drive, and what may be done with it.
import { useEffect, useState } from "preact/hooks";
import { change, link } from "../store.js";
import { Card, Empty, bytes, dayOf, duration, html, metres, saveAs, timeOfDay } from "../parts.js";
import { words } from "../words.js";
import { recordingsWords } from "./recordings_words.js";

const w = recordingsWords;
const PERIOD_MS = 2000;
const BEGINNING_BYTES = 1 << 20;

async function ask(command) {
  const answer = await (command ? change("api/recordings", command) : fetch("api/recordings"));
  const body = await answer.json();
  if (!answer.ok) throw new Error(body.detail);
  return body;
}

function useRecordings() {
  const [found, setFound] = useState(null);
  const [error, setError] = useState("");
  const look = () => ask().then(setFound, () => {}); // a lost connection is said by the bar above
  useEffect(() => {
    look();
    const timer = setInterval(look, PERIOD_MS);
    return () => clearInterval(timer);
  }, [link.value.open]);
  const run = (action, name) => ask({ action, name }).then(() => { setError(""); look(); }, (e) => setError(e.message));
  return [found, run, error];
}

function Verdicts({ s }) {
  const length = s.end_ns - s.begin_ns || 1;
  const share = (ns) => `${(100 * ns) / length}%`;
  const spans = s.trust.map((c, i) => ({ state: c.state, from: c.since_ns, to: s.trust[i + 1]?.since_ns ?? s.end_ns }));
  const said = Object.entries(spans.reduce((sum, b) => ({ ...sum, [b.state]: (sum[b.state] ?? 0) + b.to - b.from }), {}))
    .map(([state, ns]) => `${words.trust[state] ?? state} ${duration(ns / 1e9)}`).join(", ");
  return html`<div class="replay-track still" role="img" aria-label=${said ? w.verdicts(said) : w.noVerdicts} title=${said || w.noVerdicts}>
    ${spans.map((b) => html`<span class="segment ${b.state}" style=${{ left: share(b.from - s.begin_ns), width: share(b.to - b.from) }}></span>`)}
    ${s.outages.map((o) => html`<span class="outage" style=${{ left: share(o.since_ns - s.begin_ns), width: share((o.until_ns ?? s.end_ns) - o.since_ns) }}></span>`)}
  </div>`;
}

function Recording({ r, allowed, job, run }) {
  const [sure, setSure] = useState(false);
  const may = (action) => allowed.includes(action) && link.value.open;
  const s = r.summary;
  const begin = s && new Date(s.begin_ns / 1e6);
  const busy = job?.running;
  return html`<li class="recording">
    <svg viewBox="-3 -3 106 66" role="img" aria-label=${s?.outline ? w.outline : w.noOutline}>${s?.outline && html`<path d=${s.outline} />`}</svg>
    <div class="recording-text"><h3>${begin ? `${dayOf(begin.getTime())} ${timeOfDay(begin.getTime())}` : r.name}</h3>
      <p class="note">${r.recording ? w.recording : r.failed ? w.unreadable : !s ? w.computing : [duration((s.end_ns - s.begin_ns) / 1e9), s.distance_m === null ? w.noPosition : metres(s.distance_m), w.outages(s.outages.length), s.origin && words.origin[s.origin]?.[0]].filter(Boolean).join(" · ")} · ${bytes(r.size_bytes)}${r.kept ? ` · ${w.kept}` : ""}</p>
      ${s && html`<${Verdicts} s=${s} />`}
      <p class="toolbar">
        ${may("replay") && html`<button disabled=${busy} title=${busy ? w.busy : r.recording ? w.soFar : null} onClick=${() => run("replay", r.name)}>${w.replay}</button>`}
        ${may("solve") && html`<button disabled=${busy} title=${busy ? w.busy : r.recording ? w.soFar : null} onClick=${() => run("solve", r.name)}>${w.solve}</button>`}
        ${r.report && html`<a href=${`api/recordings/${encodeURIComponent(r.name)}/report`} target="_blank" rel="noopener">${w.report}</a>`}
        ${may("download") && html`<a href=${`api/recordings/${encodeURIComponent(r.name)}`} download>${w.download}</a>`}
        ${may("keep") && html`<button onClick=${() => run(r.kept ? "release" : "keep", r.name)}>${r.kept ? w.release : w.keep}</button>`}
        ${may("delete") && !r.kept && !r.recording && (sure
          ? html`<button class="danger" onClick=${() => run("delete", r.name)}>${w.sure}</button><button onClick=${() => setSure(false)}>${w.cancel}</button>`
          : html`<button onClick=${() => setSure(true)} aria-label=${w.deleteOne(r.name)}>${w.delete}</button>`)}
      </p></div>
  </li>`;
}

function JobRow({ job, run }) {
  if (!job) return null;
  const state = job.running ? w.running : job.failed ? w.failed : w.ended;
  return html`<p class="job" role="status"><strong>${w.jobs[job.action]} ${job.name}</strong> <span>${state}</span>
    ${job.port && html`<a href=${`http://${location.hostname}:${job.port}/`} target="_blank" rel="noopener">${w.open}</a>`}
    ${!job.port && job.text && html`<span class="dim">${job.text}</span>`}
    ${job.running && html`<button onClick=${() => run("stop", "")}>${w.stop}</button>`}</p>`;
}

// The browser sends the beginning of a file only; the mapping is corrected and kept by its owner.
function DraftCard() {
  const t = w.draft;
  const [found, setFound] = useState(null); // { table, name, toml, text }
  const [said, setSaid] = useState("");
  const choose = async (event) => {
    const file = event.target.files[0];
    if (!file) return;
    setFound(null);
    setSaid(t.reading);
    try {
      const answer = await change(`api/draft?name=${encodeURIComponent(file.name)}`, file.slice(0, BEGINNING_BYTES));
      const body = await answer.json();
      if (!answer.ok) throw new Error(body.detail);
      setFound({ table: file.name, ...body });
      setSaid("");
    } catch (problem) {
      setSaid(t.failed(problem.message));
    }
  };
  const save = () => saveAs(new Blob([found.toml], { type: "application/toml" }), found.name);
  return html`<${Card} title=${t.title} id="draft" fold class="draft-card">
    <p class="note block">${t.note}</p>
    <p class="block"><label>${t.choose} <input type="file" accept=".csv,.txt,.tsv,.dat,.log,text/*" onChange=${choose} /></label></p>
    <p class="note block" role="status">${said}</p>
    ${found && html`<h3>${t.preview}</h3><pre tabindex="0" aria-label=${t.preview}>${found.text}</pre>
      <label class="block"><strong>${t.mapping(found.name)}</strong>
        <textarea rows="16" spellcheck="false" value=${found.toml} onInput=${(e) => setFound({ ...found, toml: e.target.value })}></textarea></label>
      <p class="block"><button onClick=${save}>${t.save}</button></p>
      <p class="note block"><code>${t.next(found.name, found.table)}</code></p>`}
  </${Card}>`;
}

export function RecordingsPage() {
  const [found, run, error] = useRecordings();
  if (!found) return html`<p class="boot">${words.connecting}</p>`;
  return html`<div class="page"><${Card} title=${w.title} note=${found.free_bytes === null ? "" : w.free(bytes(found.free_bytes))} id="recordings">
    ${error && html`<p class="note block" role="alert">${w.refused(error)}</p>`}
    <${JobRow} job=${found.job} run=${run} />
    ${found.recordings.length ? html`<ul class="recordings">${found.recordings.map((r) => html`<${Recording} key=${r.name} r=${r} allowed=${found.allowed} job=${found.job} run=${run} />`)}</ul>`
      : html`<${Empty} title=${w.empty} why=${w.emptyWhy} />`}
    <p class="note block">${w.note}</p>
  </${Card}><${DraftCard} /></div>`;
}
