// The topic inspector: one topic's newest message as it came, its figures, and its fields, each of which can be plotted.
import { useEffect, useState } from "preact/hooks";
import { clock, contract, paused, remember, settings, togglePause } from "../store.js";
import { Age, Drawer, Empty, Row, StateIcon, copyText, html, rate, seconds } from "../parts.js";
import { words } from "../words.js";
import { systemWords } from "./system_words.js";

const FIELDS_SHOWN = 120;

// Every numeric field with its value: chosen ones are drawn on the page Charts.
function Fields({ name }) {
  const t = systemWords.inspector;
  const [listed, setListed] = useState([]);
  const [filter, setFilter] = useState("");
  useEffect(() => {
    const ask = async () => {
      try {
        const answer = await fetch(`api/fields/${name}`);
        if (answer.ok && !paused.value) setListed((await answer.json()).fields);
      } catch {
        // The unit does not answer: the drawer says so already.
      }
    };
    ask();
    const timer = setInterval(ask, 1000);
    return () => clearInterval(timer);
  }, [name]);
  const chosen = settings.value.plots ?? [];
  const toggle = (field) => remember({ plots: chosen.includes(field) ? chosen.filter((f) => f !== field) : [...chosen, field] });
  const shown = listed.filter((f) => f.path.includes(filter.trim())).slice(0, FIELDS_SHOWN);
  if (listed.length === 0) return null;
  return html`<h3>${t.fields}<input type="search" class="push" placeholder=${t.findField} aria-label=${t.findField} value=${filter} onInput=${(e) => setFilter(e.target.value)} /></h3>
    ${chosen.length > 0 && html`<p class="note block"><a href="#/charts">${t.charts(chosen.length)}</a></p>`}
    <div class="scroll fields" tabindex="0" role="group" aria-label=${t.fields}><table class="plain">
      <thead><tr>${t.fieldColumns.map((text) => html`<th scope="col">${text}</th>`)}<th><span class="sr">${t.plot}</span></th></tr></thead>
      <tbody>${shown.map((f) => html`<tr key=${f.name}><th scope="row">${f.path}${f.axis && html` <span class="dim">${f.axis}</span>`}</th><td>${+f.value.toPrecision(10)}</td><td>${f.unit}</td>
        <td><button aria-pressed=${chosen.includes(f.name)} aria-label=${t.plotField(f.path)} onClick=${() => toggle(f.name)}>${chosen.includes(f.name) ? t.plotted : t.plot}</button></td></tr>`)}</tbody></table></div>`;
}

// Newest message of one topic, asked for twice a second while it is looked at.
function useTopic(name) {
  const [found, setFound] = useState({ data: null, text: "", error: null });
  useEffect(() => {
    let stopped = false;
    setFound({ data: null, text: "", error: null });
    const ask = async () => {
      if (paused.value) return;
      try {
        const answer = await fetch(`api/topics/${name}`);
        const text = await answer.text();
        if (stopped) return;
        const data = JSON.parse(text);
        setFound((before) => (answer.ok
          ? { data, text: text.slice(text.indexOf('"message":') + 10, -1), error: null }
          : { ...before, error: data.detail }));
      } catch (problem) {
        if (!stopped) setFound((before) => ({ ...before, error: problem.message }));
      }
    };
    ask();
    const timer = setInterval(ask, 500);
    return () => {
      stopped = true;
      clearInterval(timer);
    };
  }, [name]);
  return found;
}

// Indents JSON text as it came: parsing would round the nanoseconds.
function pretty(text) {
  let depth = 0;
  let quoted = false;
  let out = "";
  for (let i = 0; i < text.length; i += 1) {
    const c = text[i];
    if (c === '"' && text[i - 1] !== "\\") quoted = !quoted;
    if (quoted) out += c;
    else if (c === "{" || c === "[") out += text[i + 1] === "}" || text[i + 1] === "]" ? c : `${c}\n${"  ".repeat((depth += 1))}`;
    else if (c === "}" || c === "]") out += text[i - 1] === "{" || text[i - 1] === "[" ? c : `\n${"  ".repeat((depth -= 1))}${c}`;
    else if (c === ",") out += `,\n${"  ".repeat(depth)}`;
    else if (c === ":") out += ": ";
    else out += c;
  }
  return out.replace(/\[([^[\]{}]{0,120})\]/g, (_, inner) => `[${inner.replace(/\s+/g, " ").trim()}]`);
}

export function TopicDrawer({ name, onClose }) {
  const t = systemWords.inspector;
  const { data, text, error } = useTopic(name);
  const [copied, setCopied] = useState(false);
  const row = contract.value.topics[name] ?? contract.value.topics[name.replace(/\/[^/]*$/, "/+")];
  clock.value;
  const copy = async () => {
    await copyText(pretty(text));
    setCopied(true);
    setTimeout(() => setCopied(false), 1500);
  };
  const head = html`<button onClick=${togglePause} aria-pressed=${paused.value}>${paused.value ? words.resume : words.pause}</button>`;
  return html`<${Drawer} title=${t.title(name)} onClose=${onClose} head=${head} wide>
    <p class="lead-text">${row?.purpose}.</p>
    ${data?.unreadable && html`<p class="verdict"><${StateIcon} state="caution" word="" />${t.failed}: ${data.unreadable}</p>`}
    ${error && html`<p class="verdict"><${StateIcon} state="caution" />${t.failed}: ${error}</p>`}
    ${data && html`<dl class="rows two">
      <${Row} label=${t.type} value=${data.type} />
      <${Row} label=${t.from} value=${data.producer ?? "-"} />
      <${Row} label=${t.rate} value=${rate(data.rate_hz)} unit="/s" unitName="messages a second" extra=${row?.stale_after_s === null && t.events} />
      <${Row} label=${t.jitter} value=${seconds(data.jitter_s)} />
      <${Row} label=${t.size} value=${data.bytes ?? "-"} unit=${data.bytes == null ? "" : t.bytes} />
      <${Row} label=${t.age} value=${html`<span key=${data.sequence} class="flash"><${Age} topic=${name} stamp=${data.updated_ns} /></span>`} />
      <${Row} label=${words.system.latency} value=${`${seconds(data.latency_p50_s)} / ${seconds(data.latency_p99_s)}`} />
      <${Row} label=${t.retained} value=${`${data.retained ? t.yes : t.no}, ${t.qos} ${data.qos}`} />
    </dl>`}
    ${data && !data.message && !data.unreadable && html`<${Empty} title=${t.empty} why=${t.emptyWhy((row?.producers ?? []).join(", ") || name.split("/")[1])} />`}
    ${data?.message && html`
      <${Fields} name=${name} />
      <h3>${t.message}<button class="push" onClick=${copy}>${copied ? words.copied : words.copy}</button></h3>
      ${data.message.hexadecimal !== undefined && html`<p class="note block">${t.bytesNote}</p>`}
      <pre tabindex="0" aria-label=${t.message}>${pretty(text)}</pre>`}
  </${Drawer}>`;
}
