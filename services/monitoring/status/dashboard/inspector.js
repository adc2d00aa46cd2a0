// The topic inspector: one topic's newest message as it came, its figures, and a plot of any number in it.
import { useEffect, useState } from "preact/hooks";
import { clock, contract, paused, togglePause } from "./store.js";
import { Age, Drawer, Empty, Row, StateIcon, copyText, html, rate, seconds } from "./parts.js";
import { words } from "./words.js";

function numbersIn(message) {
  const found = {};
  const walk = (value, path) => {
    if (typeof value === "number" && !path.endsWith("_ns")) found[path] = value;
    else if (value && typeof value === "object") Object.entries(value).forEach(([k, v]) => walk(v, path ? `${path}.${k}` : k));
  };
  walk(message, "");
  return found;
}

function Sparkline({ values, field }) {
  const known = values.filter((v) => v != null);
  if (known.length < 2) return null;
  const [low, high] = [Math.min(...known), Math.max(...known)];
  const y = (v) => (high === low ? 30 : 56 - (52 * (v - low)) / (high - low));
  const points = values.map((v, i) => (v == null ? null : `${(i * 300) / 119} ${y(v)}`)).filter(Boolean).join("L");
  return html`<figure class="spark"><svg viewBox="0 0 300 60" preserveAspectRatio="none" role="img" aria-label=${words.inspector.plotLabel(field, low, high)}><path d=${`M${points}`} /></svg>
    <figcaption><span>${low.toPrecision(6)}</span><span>${high.toPrecision(6)}</span></figcaption></figure>`;
}

// Newest message of one topic, asked for twice a second while it is looked at.
function useTopic(name) {
  const [found, setFound] = useState({ data: null, text: "", error: null, past: [] });
  useEffect(() => {
    let stopped = false;
    setFound({ data: null, text: "", error: null, past: [] });
    const ask = async () => {
      if (paused.value) return;
      try {
        const answer = await fetch(`/api/topics/${name}`);
        const text = await answer.text();
        if (stopped) return;
        const data = JSON.parse(text);
        setFound((before) => (answer.ok
          ? { data, text: text.slice(text.indexOf('"message":') + 10, -1), error: null, past: [...before.past.slice(-119), numbersIn(data.message)] }
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
  const t = words.inspector;
  const { data, text, error, past } = useTopic(name);
  const [field, setField] = useState("");
  const [copied, setCopied] = useState(false);
  const row = contract.value.topics[name] ?? contract.value.topics[name.replace(/\/[^/]*$/, "/+")];
  clock.value;
  const fields = data ? Object.keys(numbersIn(data.message)) : [];
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
      <div class="field"><label for="field">${t.plot}</label><select id="field" value=${field} onChange=${(e) => setField(e.target.value)}>
        <option value="">${t.plotNone}</option>${fields.map((f) => html`<option value=${f}>${f}</option>`)}</select></div>
      ${field && html`<${Sparkline} field=${field} values=${past.map((n) => n[field] ?? null)} />`}
      <h3>${t.message}<button class="push" onClick=${copy}>${copied ? words.copied : words.copy}</button></h3>
      ${data.message.hexadecimal !== undefined && html`<p class="note block">${t.bytesNote}</p>`}
      <pre tabindex="0" aria-label=${t.message}>${pretty(text)}</pre>`}
  </${Drawer}>`;
}
