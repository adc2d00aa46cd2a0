// The five layers, live: processes as lists, topics as lines between them, outages, and why the unit does what it does.
import { useEffect, useLayoutEffect, useRef, useState } from "preact/hooks";
import { brokerAnswers, clock, connected, contract, freshness, isOld, nowMs, state } from "../store.js";
import {
  Age, Card, Drawer, FRESH_STATE, KindsTable, Row, STATUS_STATE, StateIcon, bytes, dayOf, duration, fixed, html, percent, rate, seconds, timeOfDay, told, unfold,
} from "../parts.js";
import { Made, useMadeFile } from "../made_file.js";
import { TopicDrawer } from "./inspector.js";
import { words } from "../words.js";
import { systemWords } from "./system_words.js";

const w = words.system;
const DIP = 26; // how far a line between neighbours hangs down, in px
const short = (name) => name.split(".")[1];
const statusOf = (name) => (brokerAnswers() ? state.value.processes[name].status : "unknown");

function Node({ name, onHover }) {
  const p = state.value.processes[name];
  const status = statusOf(name);
  return html`<li><a class="node ${STATUS_STATE[status]}" id=${`node-${name}`} href=${`#/system?node=${name}`}
    onMouseEnter=${() => onHover(name)} onMouseLeave=${() => onHover(null)} onFocus=${() => onHover(name)} onBlur=${() => onHover(null)}>
    <span class="name"><${StateIcon} state=${STATUS_STATE[status]} word=${words.status[status]} /><span class="sr">${name}</span><span aria-hidden="true">${short(name).split(/(?=_)/).map((part) => html`<wbr />${part}`)}</span>${p.restarts > 0 && html`<span class="restarts">${w.restarted(p.restarts)}</span>`}</span>
    <span class="figures">${status === "waiting" || status === "missing" ? words.status[status]
      : status !== "ready" ? html`<strong>${words.status[status]}</strong>`
      : html`<span aria-hidden="true">${[p.out_hz == null ? null : `${rate(p.out_hz)}/s`, p.latency_p99_s == null ? null : seconds(p.latency_p99_s)].filter(Boolean).join(" · ")}</span><span class="sr">${w.load(rate(p.out_hz), seconds(p.latency_p99_s))}</span>`}</span>
  </a></li>`;
}

// One line a topic and consumer; those that observe every topic are no consumers of one, and are drawn once, as a rail.
function edgesOf(rows) {
  const edges = [];
  for (const [topic, row] of Object.entries(rows.topics)) {
    for (const from of row.producers) {
      for (const to of row.consumers) {
        const received = state.value.topics[topic]?.updated_ns != null;
        const fitted = state.value.processes[from].status !== "absent" && state.value.processes[to].status !== "absent";
        if (received && fitted && from !== to) edges.push({ topic, from, to });
      }
    }
  }
  return edges;
}

// A line leaves towards its consumer: upwards, downwards, or from below to a neighbour in the same row.
function layOut(box, edges) {
  const frame = box.getBoundingClientRect();
  const ports = new Map();
  const middle = (name) => {
    const r = box.querySelector(`[id="node-${name}"]`).getBoundingClientRect();
    return { left: r.left - frame.left, width: r.width, top: r.top - frame.top, bottom: r.bottom - frame.top, x: r.left - frame.left + r.width / 2 };
  };
  const ends = edges.map((edge) => {
    const a = middle(edge.from);
    const b = middle(edge.to);
    const sides = b.bottom <= a.top ? ["top", "bottom"] : b.top >= a.bottom ? ["bottom", "top"] : ["bottom", "bottom"];
    const keys = [`${edge.from} ${sides[0]}`, `${edge.to} ${sides[1]}`];
    keys.forEach((key, i) => ports.set(key, [...(ports.get(key) ?? []), { edge, x: i ? a.x : b.x }]));
    return { edge, sides, a, b, keys };
  });
  for (const list of ports.values()) list.sort((p, q) => p.x - q.x);
  const at = (box2, key, edge) => {
    const list = ports.get(key);
    return box2.left + (box2.width * (list.findIndex((p) => p.edge === edge) + 1)) / (list.length + 1);
  };
  return ends.map(({ edge, sides, a, b, keys }) => {
    const x1 = at(a, keys[0], edge);
    const x2 = at(b, keys[1], edge);
    const y1 = a[sides[0]];
    const y2 = b[sides[1]];
    const beside = sides[0] === sides[1];
    const c1 = beside ? y1 + DIP : (y1 + y2) / 2;
    const c2 = beside ? y2 + DIP : (y1 + y2) / 2;
    return { ...edge, x1, y1, c1, x2, y2, c2, d: `M${x1} ${y1}C${x1} ${c1} ${x2} ${c2} ${x2} ${y2}` };
  });
}

// Where on its curve a line is named: neighbours take turns, so that their names do not cover each other.
function nameAt(line, turn) {
  const t = [0.5, 0.28, 0.72, 0.4, 0.6][turn % 5];
  const u = 1 - t;
  const on = (p1, p2, p3, p4) => u * u * u * p1 + 3 * u * u * t * p2 + 3 * u * t * t * p3 + t * t * t * p4;
  return { x: on(line.x1, line.x1, line.x2, line.x2), y: on(line.y1, line.c1, line.c2, line.y2) + 4 };
}

function Edges({ box, hovered }) {
  clock.value;
  const [lines, setLines] = useState([]);
  const edges = edgesOf(contract.value);
  const key = edges.map((e) => `${e.topic} ${e.from} ${e.to}`).join();
  useLayoutEffect(() => {
    const draw = () => box.current && setLines(layOut(box.current, edges));
    draw();
    const observer = new ResizeObserver(draw);
    observer.observe(box.current);
    return () => observer.disconnect();
  }, [key]);
  let turn = 0;
  return html`<svg class="edges" aria-hidden="true">${lines.map((line) => {
    const flow = state.value.topics[line.topic];
    const fresh = freshness(line.topic, flow?.updated_ns);
    const active = hovered === line.from || hovered === line.to;
    const width = 1.25 + Math.log10(1 + (flow?.rate_hz ?? 0)) * 1.5;
    return html`<g class="edge ${fresh} ${active ? "active" : hovered ? "away" : ""}">
      <path d=${line.d} style=${{ strokeWidth: width }} />
      ${active && html`<text ...${nameAt(line, turn++)}>${[line.topic, flow.rate_hz ? `${rate(flow.rate_hz)}/s` : null, flow.latency_p99_s == null ? null : seconds(flow.latency_p99_s)].filter(Boolean).join(" · ")}</text>`}
    </g>`;
  })}</svg>`;
}

function Layer({ names, onHover }) {
  const absent = names.filter((name) => state.value.processes[name].status === "absent");
  return html`<ul>${names.filter((name) => !absent.includes(name)).map((name) => html`<${Node} key=${name} name=${name} onHover=${onHover} />`)}</ul>
    ${absent.length > 0 && html`<p class="absent">${w.notFitted} ${absent.map((name) => html`<a href=${`#/system?node=${name}`}>${short(name)}</a> `)}</p>`}`;
}

// What figures and lines mean; the lines are those of the drawing itself.
function Legend() {
  const t = w.legend;
  return html`<div class="key-card">
    <p class="key-figures"><span class="figures">${t.example[0]}</span> ${t.rate} <span class="figures">${t.example[1]}</span> ${t.latency}</p>
    <ul class="legend lines">${["fresh", "late", "stale", "quiet"].map((kind) => html`<li>
      <svg class="edge ${kind}" width="40" height="10" aria-hidden="true"><path d="M2 5H38" style=${{ strokeWidth: kind === "fresh" ? 3 : 2 }} /></svg>${t.lines[kind]}</li>`)}</ul>
  </div>`;
}

function LayersCard() {
  const box = useRef(null);
  const [hovered, setHovered] = useState(null);
  const processes = Object.entries(contract.value.processes);
  const { bus } = state.value;
  return html`<${Card} title=${w.map} note=${w.mapNote} id="layers" class="layers-card">
    <div class="layers" ref=${box}>
      <${Edges} box=${box} hovered=${hovered} />
      ${[5, 4, 3, 2, 1].map((layer) => html`
        <section class="layer layer-${layer}" aria-label=${`${layer} ${w.layers[layer - 1]}`}>
          <h3><span class="number">${layer}</span>${w.layers[layer - 1]}<span class="note">${w.layerNotes[layer - 1]}</span></h3>
          <${Layer} names=${processes.filter(([, p]) => p.layer === layer).map(([name]) => name)} onHover=${setHovered} />
          ${layer === 5 && html`<p class="rail"><span>${w.everything}${connected() ? ` · ${words.footer.rate(rate(bus.messages_hz))}` : ""}</span></p>`}
        </section>`)}
    </div>
    <${Legend} />
  </${Card}>`;
}

function NodeDrawer({ name, onClose }) {
  const p = state.value.processes[name];
  const row = contract.value.processes[name];
  clock.value;
  const status = statusOf(name);
  const topics = Object.entries(contract.value.topics);
  const published = topics.filter(([, t]) => t.producers.includes(name)).map(([topic]) => topic);
  const subscribed = topics.filter(([, t]) => t.consumers.includes(name)).map(([topic]) => topic);
  const rejects = Object.entries(p.rejects ?? {}).map(([kind, n]) => `${n} × ${kind} (${p.reject_names?.[kind] ?? kind})`).join("; ");
  const list = (names) => (names.length ? html`<ul class="tags">${names.map((t) => html`<li><a href=${`#/system?topic=${t}`}>${t}</a></li>`)}</ul>` : words.system.nothing);
  return html`<${Drawer} title=${w.drawer(name)} onClose=${onClose}>
    <p class="lead-text">${row.purpose}.</p>
    <p class="verdict"><${StateIcon} state=${STATUS_STATE[status]} word="" /><strong>${words.status[status]}</strong> ${systemWords.statusWhy[status]}</p>
    <dl class="rows">
      <${Row} label=${w.heartbeat} value=${html`<${Age} topic=${`health/${name}`} stamp=${p.heartbeat_ns} />`} />
      <${Row} label=${w.uptime} value=${p.since_ns && status === "ready" ? duration(Math.max(0, (nowMs() - p.since_ns / 1e6) / 1000)) : "-"} />
      <${Row} label=${w.restarts} value=${p.restarts} />
      <${Row} label=${w.lastError} value=${p.last_error ?? w.noError} />
      <${Row} label=${w.sent} value=${rate(p.out_hz)} unit="/s" unitName="messages a second" />
      <${Row} label=${w.received} value=${rate(p.in_hz)} unit="/s" unitName="messages a second" />
      <${Row} label=${w.latency} value=${`${seconds(p.latency_p50_s)} / ${seconds(p.latency_p99_s)}`} extra=${p.latency_of && w.latencyOf(p.latency_of)} />
      <${Row} label=${w.cpu} value=${percent(p.cpu_share)} extra=${w.cpuNote} />
      <${Row} label=${w.memory} value=${bytes(p.memory_bytes)} />
      <${Row} label=${w.rejects} value=${rejects || w.none} />
      <${Row} label=${w.dropped} value=${p.dropped ?? 0} extra=${w.droppedNote} />
      <${Row} label=${w.reconnections} value=${p.reconnections ?? 0} />
    </dl>
    <${KindsTable} kinds=${p.kinds ?? []} />
    <h3>${w.publishes}</h3>${list([...published, `health/${name}`])}
    <h3>${w.subscribes}</h3>${row.observes_all ? html`<p>${w.everything}</p>` : list(subscribed)}
  </${Drawer}>`;
}

function TopicsCard() {
  const t = words.topics;
  const [filter, setFilter] = useState("");
  clock.value;
  const all = Object.entries(state.value.topics);
  const shown = all.filter(([name]) => (filter ? name.includes(filter.trim()) : !/^(health|consumed)\//.test(name)));
  return html`<${Card} title=${t.title} id="topics" fold class="topics-card"
    aside=${html`<input type="search" id="find" placeholder=${t.filter} aria-label=${t.filter} value=${filter} onInput=${(e) => setFilter(e.target.value)} />`}>
    ${shown.length === 0 ? html`<p class="note block">${t.noMatch(filter)}</p>` : html`
    <div class="scroll" tabindex="0" role="group" aria-label=${t.title}><table class="plain topics">
      <thead><tr><th scope="col">${t.columns.topic}</th><th scope="col" class="wide-only">${t.columns.state}</th><th scope="col" class="number">${t.columns.rate}</th><th scope="col" class="number wide-only">${t.columns.latency}</th><th scope="col" class="number">${t.columns.age}</th></tr></thead>
      <tbody>${shown.map(([name, flow]) => {
        const fresh = freshness(name, flow.updated_ns);
        const never = flow.updated_ns == null;
        const word = fresh === "quiet" && never ? t.noEvent : t[fresh];
        return html`<tr key=${name}><th scope="row"><span class="with-icon"><${StateIcon} state=${FRESH_STATE[fresh]} word=${word} /><a href=${`#/system?topic=${name}`} aria-label=${t.open(name)}>${name.split(/(?<=[/_])/).map((part) => html`${part}<wbr />`)}</a></span></th>
          <td class="wide-only">${word}</td>
          <td class="number">${flow.rate_hz ? `${rate(flow.rate_hz)} ${t.perSecond}` : fresh === "quiet" ? html`<span class="dim">${t.events}</span>` : never ? "-" : `0 ${t.perSecond}`}</td>
          <td class="number wide-only">${seconds(flow.latency_p99_s)}</td>
          <td class="number">${never ? "-" : html`<${Age} topic=${name} stamp=${flow.updated_ns} />`}</td></tr>`;
      })}</tbody></table></div>
    <ul class="legend">${["fresh", "late", "stale", "earlier", "never", "quiet"].map((kind) => html`<li><${StateIcon} state=${FRESH_STATE[kind]} word="" />${t.legend[kind]}</li>`)}</ul>`}
  </${Card}>`;
}

function OutagesCard() {
  const t = systemWords.outages;
  clock.value;
  const list = state.value.outages;
  const open = new Set(list.filter((o) => o.until_ns == null).map((o) => o.what));
  const others = state.value.problems.filter((p) => !open.has(p.what)); // nothing is silent because of them
  return html`<${Card} title=${t.title} note=${t.note} id="outages">
    ${others.length > 0 && html`<ul class="outages">${others.map((p) => html`<li key=${p.what} class="open">
      <span><${StateIcon} state="caution" word="" /><strong>${p.what}</strong></span>
      <span class="number">${p.since_ns == null ? "" : duration(Math.max(0, (nowMs() - p.since_ns / 1e6) / 1000))}</span>
      <span class="dim">${told(p, p.text)}</span>
    </li>`)}</ul>`}
    ${list.length === 0 ? others.length === 0 && html`<p class="note block">${t.empty}</p>` : html`<ul class="outages">${list.map((o) => {
      const open = o.until_ns == null;
      const span = Math.max(0, ((open ? nowMs() : o.until_ns / 1e6) - o.since_ns / 1e6) / 1000);
      return html`<li key=${`${o.what}${o.since_ns}`} class=${open ? "open" : ""}>
        <span><${StateIcon} state=${open ? "stale" : "info"} word="" /><strong>${o.what}</strong>${open && html` <em>${t.open}</em>`}</span>
        <span class="number">${fixed(span, span < 10 ? 1 : 0)} s</span>
        <span class="dim">${timeOfDay(o.since_ns / 1e6)} ${words.utc} · ${told(o, o.cause)}${o.affected.length > 0 && html` · ${t.affected(o.affected)}`}</span>
      </li>`;
    })}</ul>`}
  </${Card}>`;
}

// Why the unit does what it does, in its own words.
function UnitCard() {
  const t = systemWords.unitCard;
  const { mode, navigation, recording } = state.value;
  clock.value;
  const old = (topic, message) => isOld(topic, message?.updated_ns);
  const sources = mode && [mode.gnss_source, mode.imu_source, mode.speed_source].filter(Boolean).join(", ");
  return html`<${Card} title=${t.title} note=${t.note} id="unit" fold><dl class="rows">
    <${Row} dim=${old("mode/state", mode)} label=${t.mode} value=${mode ? mode.mode.replaceAll("_", " ") : words.topics.never} extra=${mode?.reason} />
    ${mode && html`<${Row} dim=${old("mode/state", mode)} label=${t.modeFor} value=${duration(Math.max(0, (nowMs() - mode.since_ns / 1e6) / 1000))} />
    <${Row} dim=${old("mode/state", mode)} label=${t.sources} value=${sources || t.none} />`}
    <${Row} dim=${old("navigation/state", navigation)} label=${t.filter} value=${navigation ? words.position.phases[navigation.phase] ?? navigation.phase : words.topics.never} extra=${navigation?.reason} />
    ${navigation && html`<${Row} dim=${old("navigation/state", navigation)} label=${t.fixes} value=${t.usedRejected(navigation.fixes_used, navigation.fixes_rejected)} />
    <${Row} dim=${old("navigation/state", navigation)} label=${t.samples} value=${t.usedRejected(navigation.samples_used, navigation.samples_rejected)} />
    <${Row} dim=${old("navigation/state", navigation)} label=${t.gaps} value=${t.gapsResets(navigation.imu_gaps, navigation.resets)} />`}
    <${Row} dim=${old("recording/state", recording)} label=${t.recording} value=${recording?.file ?? (recording ? words.footer.notRecording : words.topics.never)} extra=${recording?.reason ?? (recording && t.written(bytes(recording.bytes_written), recording.dropped))} />
  </dl></${Card}>`;
}

// The connection to the control centre, of a unit that has one.
function CentreCard() {
  const t = words.uplink;
  const { uplink: u } = state.value;
  clock.value;
  if (!u) return null;
  const dim = isOld("uplink/state", u.updated_ns);
  const day = (ns) => `${dayOf(ns / 1e6)} ${timeOfDay(ns / 1e6).slice(0, 5)}`;
  const about = [u.oldest_ns && u.backlog_batches > 0 && t.since(day(u.oldest_ns)), t.lost(u.backlog_refused, u.dropped)].filter(Boolean).join(", ");
  return html`<${Card} title=${t.centre} id="centre" aside=${html`<${Age} topic="uplink/state" stamp=${u.updated_ns} />`}><dl class="rows">
    <${Row} dim=${dim} label=${words.chain.title} value=${u.connected ? t.connected(u.centre) : t.offline} extra=${u.offline} />
    <${Row} dim=${dim} label=${t.tracking} value=${t.trackings[u.tracking] ?? u.tracking} extra=${u.watchers > 0 && `${t.watched.toLowerCase()} ${t.watchers(u.watchers)}`} />
    <${Row} dim=${dim} label=${t.waiting} value=${t.batches(u.backlog_batches, bytes(u.backlog_bytes))} extra=${about} />
    <${Row} dim=${dim} label=${t.sent} value=${t.sentReceipted(bytes(u.sent_bytes), u.receipted)} />
    ${u.certificate_until_ns && html`<${Row} dim=${dim} label=${t.until} value=${day(u.certificate_until_ns)} unit=${words.utc} />`}
  </dl></${Card}>`;
}

// What somebody who helps needs to know, as one file; it takes some seconds, and nothing is sent elsewhere.
function SupportCard() {
  const t = systemWords.support;
  const [told, make] = useMadeFile({ ...t, making: t.collecting });
  return html`<${Card} title=${t.title} note=${t.note} id="support" fold>
    <p class="block"><button disabled=${told.busy} onClick=${() => make("api/support", "obu-support.zip")}>${t.download}</button></p>
    <${Made} told=${told} />
  </${Card}>`;
}

// What driving has shown of axes, signs, delays and scales; findings first.
function SetUpCard() {
  const t = systemWords.setUp;
  const { set_up: setUp } = state.value;
  const order = ["contradicts", "agrees", "unknown"];
  const checks = [...(setUp?.checks ?? [])].sort((a, b) => order.indexOf(a.verdict) - order.indexOf(b.verdict));
  const known = checks.filter((c) => c.verdict !== "unknown");
  const unknown = checks.filter((c) => c.verdict === "unknown").map((c) => t.names[c.name] ?? c.name);
  return html`<${Card} title=${t.title} note=${t.note} id="set-up" fold=${!checks.some((c) => c.verdict === "contradicts")}>
    ${known.length === 0 && html`<p class="note block">${t.empty}</p>`}
    <ul class="outages">${known.map((c) => html`<li key=${c.name} class=${c.verdict === "contradicts" ? "open" : ""}>
      <span><${StateIcon} state=${c.verdict === "contradicts" ? "caution" : "safe"} word=${t.verdicts[c.verdict]} /><strong>${t.names[c.name] ?? c.name}</strong></span>
      <span class="dim">${c.sentence}</span>
      ${c.setting && html`<span class="dim">${t.setting} <code>${c.setting}</code></span>`}
    </li>`)}</ul>
    ${unknown.length > 0 && html`<p class="note block">${t.unknown(unknown)}</p>`}
  </${Card}>`;
}

export function SystemPage({ query, go }) {
  const back = () => go("#/system");
  const asked = query.has("find"); // the key / was pressed, maybe before this page was there
  useEffect(() => {
    if (!asked) return;
    unfold("topics");
    requestAnimationFrame(() => document.getElementById("find").focus());
    back();
  }, [asked]);
  const node = query.get("node");
  const topic = query.get("topic");
  return html`<div class="page system"><${LayersCard} /><${TopicsCard} /><div class="stack"><${OutagesCard} /><${SetUpCard} /><${UnitCard} /><${CentreCard} /><${SupportCard} /></div>
    ${node && contract.value.processes[node] && html`<${NodeDrawer} key=${node} name=${node} onClose=${back} />`}
    ${topic && html`<${TopicDrawer} key=${topic} name=${topic} onClose=${back} />`}
  </div>`;
}
