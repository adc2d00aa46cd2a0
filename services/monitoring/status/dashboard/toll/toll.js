// The page Toll of a road-side unit: the plaza from above, its lanes, its passages, and the account of every detection.
import { useState } from "preact/hooks";
import { clock, isOld as old, link, nowMs, state } from "../store.js";
import { Age, Card, Drawer, Empty, Row, StateIcon, compass, duration, fixed, html, languageOf, metres, percent, rate, timeOfDay, told } from "../parts.js";
import { words } from "../words.js";
import { tollWords } from "./toll_words.js";

const w = tollWords;
const PATH_S = 10;
const LETTER_M = 8; // of the names of lanes in their margin
const STATE_ICON = { open: "info", crossed: "info", charged: "safe", held: "caution", undecided: "caution", unregistered: "off", suspect: "unsafe", void: "off", missed: "unsafe" };
const OUTCOMES = ["charged", "review", "held", "undecided", "unregistered", "paid_otherwise", "suspect", "void", "missed"];
// What the passage is, in a word; a charge that was reversed is none any more.
const stateOf = (p) => (p.reversed && p.state === "charged" ? w.reversed : w.states[p.state]);
function iconOf(p) {
  if (p.state !== "charged") return STATE_ICON[p.state];
  // Final, but no detector has seen it, or the sender of its CAM is not authenticated.
  return p.reversed ? "off" : p.confirmed === false || !p.authenticated ? "info" : STATE_ICON.charged;
}
const outcomeName = (name) => w.outcomes[name] ?? w.states[name];
const explained = (p) => (p.state === "charged" && p.reversed ? w.explained.reversed : p.state === "charged" && p.confirmed === false ? w.explained.unconfirmed : w.explained[p.state]);
const paths = new Map(); // of each track: [ns, north, east] of the last seconds
let drawnNs = null;

const amount = (cents, currency) => (cents == null ? words.age.bar : `${(cents / 100).toFixed(2)} ${currency ?? ""}`);
const ago = (ns) => (ns == null || nowMs() === null ? words.age.bar : w.ago(duration(Math.max(0, (nowMs() - ns / 1e6) / 1000))));

function remember(t) {
  if (t.tracks_ns === drawnNs) return;
  drawnNs = t.tracks_ns;
  const seen = new Set(t.tracks.map((track) => track.track));
  for (const number of paths.keys()) if (!seen.has(number)) paths.delete(number);
  for (const { track, at } of t.tracks) {
    const path = (paths.get(track) ?? []).filter(([ns]) => ns > t.tracks_ns - PATH_S * 1e9);
    paths.set(track, [...path, [t.tracks_ns, ...at]]);
  }
}

// The drawing's axes: x along the lanes, y across them, so that a long plaza fits a wide card.
function frameOf(plaza) {
  const first = plaza.lanes[0];
  const [a, b] = [first.centre[0], first.centre.at(-1)];
  const angle = Math.atan2(b[1] - a[1], b[0] - a[0]);
  const turn = ([north, east]) => [north * Math.cos(angle) + east * Math.sin(angle), -north * Math.sin(angle) + east * Math.cos(angle)];
  return { turn, angle };
}

function Vehicle({ v, turn, angle, across }) {
  const [x, y] = turn(v.at);
  const [major, minor, orientation] = v.ellipse;
  const kind = !v.registered ? "unregistered" : v.lane === null ? "undecided" : "decided";
  const path = (paths.get(v.track) ?? []).map(([, north, east]) => turn([north, east])).map(([px, py]) => `${px.toFixed(1)},${(py * across).toFixed(1)}`).join(" ");
  return html`<g class="track ${kind}">
    <polyline class="trail" points=${path} />
    <ellipse cx=${x} cy=${y * across} rx=${major} ry=${minor * across} transform=${`rotate(${((orientation - angle) * 180) / Math.PI} ${x} ${y * across})`} />
    <path d="M7 0 -5 4V-4z" transform=${`translate(${x} ${y * across}) rotate(${((v.heading_rad - angle) * 180) / Math.PI})`} />
    ${Object.entries(v.lanes).map(([, p], i) => html`<rect class="bar-ground" x=${x - 5 + i * 3.6} y=${y * across - 17} width="3" height="10" /><rect class="bar-level" x=${x - 5 + i * 3.6} y=${y * across - 7 - 10 * p} width="3" height=${10 * p} />`)}
  </g>`;
}

function Picture({ t }) {
  const { turn, angle } = frameOf(t.plaza);
  const points = t.plaza.lanes.flatMap((lane) => lane.centre.map(turn));
  const gate = turn(t.plaza.lanes[0].gate[0])[0];
  const [left, right] = [Math.max(Math.min(...points.map((p) => p[0])), gate - 220), Math.min(Math.max(...points.map((p) => p[0])), gate + 220)];
  const [top, bottom] = [Math.min(...points.map((p) => p[1])), Math.max(...points.map((p) => p[1]))];
  const margin = LETTER_M * (1 + Math.min(12, Math.max(...t.plaza.lanes.map((lane) => lane.lane.length))));
  const across = 5; // lanes are drawn wider than long, to tell them apart
  const box = [left - margin, (top - 6) * across, right - left + margin, (bottom - top + 12) * across];
  const line = (ends, kind) => {
    const [[x1, y1], [x2, y2]] = ends.map(turn);
    return html`<line class=${kind} x1=${x1} y1=${y1 * across} x2=${x2} y2=${y2 * across} />`;
  };
  const directions = [...new Map(t.plaza.lanes.map((lane) => [lane.direction, lane])).values()];
  const stale = old("toll/tracks", t.tracks_ns);
  return html`<svg class="plaza ${stale ? "old" : ""}" viewBox=${box.join(" ")} role="img" aria-label=${w.picture(t.plaza.name, t.tracks.length)}>
    ${t.plaza.lanes.map((lane) => html`<polyline class="lane" style=${{ strokeWidth: lane.width_m * across }} points=${lane.centre.map(turn).map(([x, y]) => `${x},${y * across}`).join(" ")} />`)}
    ${directions.map((lane) => html`${line(lane.approach, "approach")}${line(lane.gate, "gate")}${line(lane.exit, "exit")}`)}
    ${t.tracks.map((v) => html`<${Vehicle} key=${v.track} v=${v} turn=${turn} angle=${angle} across=${across} />`)}
    <rect class="margin" x=${box[0]} y=${box[1]} width=${margin} height=${box[3]} />
    ${t.plaza.lanes.map((lane) => {
      const along = lane.centre.map(turn);
      const middle = along.reduce((sum, p) => sum + p[1], 0) / along.length;
      return html`<text x=${left - margin / 2} y=${middle * across} dy="5" class=${t.gates[lane.lane]?.open ? "open" : ""}>${lane.lane}</text>`;
    })}
  </svg>`;
}

function TracksTable({ t }) {
  const c = w.trackColumns;
  const most = (v) => Object.entries(v.lanes).sort((a, b) => b[1] - a[1])[0];
  return html`<div class="scroll" tabindex="0" role="group" aria-label=${w.approaching}><table class="plain"><thead><tr>${[c.track, c.lane, c.probability, c.speed, c.heading, c.ellipse, c.contract, c.signature].map((name) => html`<th scope="col">${name}</th>`)}</tr></thead>
    <tbody>${t.tracks.map((v) => html`<tr key=${v.track}><th scope="row">${v.track}</th><td>${v.lane ?? w.undecided(most(v)?.[0])}</td><td>${percent(most(v)?.[1])}</td>
      <td>${fixed(v.speed_m_s * 3.6, 0)} km/h</td><td>${fixed(compass(v.heading_rad), 0)}°</td><td>± ${metres(v.ellipse[0])}</td><td>${v.registered ? w.registered : w.unregistered}</td><td><${Signature} v=${v} /></td></tr>`)}</tbody></table></div>`;
}

// What was checked of a sender. Green is only what is verified whole; without a signature there is nothing to check.
function Signature({ v }) {
  const shown = html`<span class=${v.verified ? "" : "dim"} lang=${languageOf(v)}>${told(v, v.authentication)}</span>`;
  return v.verified ? html`<${StateIcon} state="safe" word="" /> ${shown}` : shown;
}

// Of each state of signatures, a vehicle with it and the number of those.
function signatures(tracks) {
  const vehicles = new Map(tracks.map((v) => [v.authentication, v]));
  return [...vehicles].map(([authentication, v]) => [v, tracks.filter((track) => track.authentication === authentication).length]);
}

function PlazaCard({ t }) {
  const [table, setTable] = useState(false);
  remember(t);
  if (!t.plaza) return html`<${Card} title=${w.title} id="plaza" class="plaza-card"><${Empty} title=${w.empty} why=${w.emptyWhy} /></${Card}>`;
  return html`<${Card} title=${w.plaza(t.plaza.name)} id="plaza" class="plaza-card" note=${w.vehicles(t.tracks.length)}
    aside=${html`<${Age} topic="toll/tracks" stamp=${t.tracks_ns} /> <button class="link" aria-pressed=${table} onClick=${() => setTable(!table)}>${table ? words.closeup.picture : words.closeup.table}</button>`}>
    ${table ? html`<${TracksTable} t=${t} />` : html`<${Picture} t=${t} />`}
    <ul class="legend"><li><span class="lane-key decided"></span>${w.legend.decided}</li><li><span class="lane-key undecided"></span>${w.legend.undecided}</li><li><span class="lane-key unregistered"></span>${w.legend.unregistered}</li><li class="dim">${w.legend.bars}</li>${signatures(t.tracks).map(([v, n]) => html`<li><${Signature} v=${v} />: ${n}</li>`)}</ul>
  </${Card}>`;
}

function LanesCard({ t }) {
  const c = w.laneColumns;
  const last = (lane) => t.ledger?.recent.find((p) => p.lane === lane);
  return html`<${Card} title=${w.lanes} id="lanes" class="lanes-card">
    ${!t.plaza ? html`<p class="note block">${w.empty}</p>` : html`<table class="plain"><thead><tr>${[c.lane, c.gate, c.passage, c.pulse].map((name) => html`<th scope="col">${name}</th>`)}</tr></thead>
    <tbody>${t.plaza.lanes.map(({ lane, mode }) => {
      const gate = t.gates[lane];
      const valid = gate && nowMs() !== null && gate.valid_until_ns / 1e6 > nowMs();
      const passage = last(lane);
      return html`<tr key=${lane}><th scope="row">${lane}<span class="reason dim block">${w.modes[mode]}</span></th>
        <td>${!valid ? w.gate.none : gate.open ? w.gate.open : w.gate.hold}</td>
        <td>${passage ? html`<${StateIcon} state=${iconOf(passage)} word="" /> ${stateOf(passage)}` : words.age.bar}</td><td>${ago(t.pulses[lane])}</td></tr>`;
    })}</tbody></table>`}
  </${Card}>`;
}

function PassagesCard({ t, onOpen }) {
  const c = w.columns;
  const rows = t.ledger?.recent ?? [];
  return html`<${Card} title=${w.passages} id="passages" class="passages-card" note=${w.passagesNote}>
    ${!rows.length ? html`<p class="note block">${w.noPassages}</p>` : html`<div class="scroll" tabindex="0" role="group" aria-label=${w.passages}><table class="plain"><thead><tr>
      ${[c.time, c.lane, c.state, c.amount].map((name) => html`<th scope="col">${name}</th>`)}${[c.probability, c.tariff, c.receipt].map((name) => html`<th scope="col" class="wide-only">${name}</th>`)}</tr></thead>
    <tbody>${rows.map((p) => html`<tr key=${p.passage_id}><th scope="row"><button class="link" onClick=${() => onOpen(p)}>${p.crossing_ns ? timeOfDay(p.crossing_ns / 1e6) : w.notCrossed}</button></th><td>${p.lane ?? words.age.bar}</td>
      <td><span class="with-icon"><${StateIcon} state=${iconOf(p)} word="" />${stateOf(p)}</span>${p.state === "charged" && (p.confirmed === false || p.ghosts > 0) && html`<span class="reason dim block">${p.reason}</span>`}${p.state === "charged" && !p.authenticated && html`<span class="reason dim block">${w.notAuthenticated}</span>`}</td><td>${amount(p.amount_cents, p.currency)}</td>
      <td class="wide-only">${percent(p.probability)}</td><td class="wide-only">${p.tariff_class ?? words.age.bar}</td><td class="wide-only">${p.state === "charged" ? (p.receipt ? w.receiptHere : w.receiptWaiting) : words.age.bar}</td></tr>`)}</tbody></table></div>`}
  </${Card}>`;
}

// Whether the account of an hour agrees is known when all of it is closed; that it does not agree is known before.
function Agreement({ b }) {
  const open = b.provisional + b.pending;
  if (!b.agrees) return html`<${StateIcon} state="unsafe" word=${w.disagrees} />`;
  return open > 0 ? html`<span class="with-icon"><${StateIcon} state="initialising" word="" />${w.open(open)}</span>` : html`<${StateIcon} state="safe" word=${w.agrees} />`;
}

function AccountCard({ t }) {
  const l = t.ledger;
  if (!l) return html`<${Card} title=${w.account} id="account" class="account-card"><${Empty} title=${w.noLedger} why=${w.noLedgerWhy} /></${Card}>`;
  const c = w.accountColumns;
  return html`<${Card} title=${w.account} id="account" class="account-card" note=${w.accountNote} aside=${html`<${Age} topic="ledger/state" stamp=${l.updated_ns} />`}>
    ${l.problem && html`<p class="with-icon problem"><${StateIcon} state="unsafe" word=${w.problem} />${l.problem}</p>`}
    ${!l.lanes.length ? html`<p class="note block">${w.noDetections}</p>` : html`<div class="scroll" tabindex="0" role="group" aria-label=${w.account}><table class="plain numbers-table"><thead><tr><th scope="col">${c.lane}</th><th scope="col">${c.hour}</th><th scope="col">${c.detections}</th>${OUTCOMES.map((name) => html`<th scope="col">${outcomeName(name)}</th>`)}<th scope="col">${c.pending}</th><th scope="col">${c.agrees}</th></tr></thead>
    <tbody>${l.lanes.map((b) => html`<tr key=${`${b.lane}${b.hour_ns}`}><th scope="row">${b.lane}</th><td>${timeOfDay(b.hour_ns / 1e6).slice(0, 5)}</td><td>${b.detections}</td>${OUTCOMES.map((name) => html`<td>${b[name]}</td>`)}<td>${b.pending}</td>
      <td><${Agreement} b=${b} />${b.charged_without_detection > 0 && w.withoutDetection(b.charged_without_detection)}${b.unconfirmed > 0 && w.unconfirmedIn(b.unconfirmed)}</td></tr>`)}</tbody></table></div>`}
    <dl class="rows"><${Row} label=${w.transactions} value=${l.transactions} extra=${w.reversals(l.reversals)} />
      <${Row} label=${w.heldRow} value=${l.held} extra=${w.heldWhy} /><${Row} label=${w.reviewRow} value=${l.in_review} extra=${w.reviewWhy} />
      <${Row} label=${w.unconfirmedRow} value=${l.unconfirmed} extra=${w.unconfirmedWhy} />
      <${Row} label=${w.notAuthenticatedRow} value=${l.not_authenticated} extra=${l.require_authenticated ? w.required : w.notRequired} />
      <${Row} label=${w.alarms} value=${l.alarms} extra=${l.newest_alarm && w.alarm[l.newest_alarm.kind](l.newest_alarm.lane, timeOfDay(l.newest_alarm.until_ns / 1e6))} />
      <${Row} label=${w.outbox} value=${l.outbox} extra=${l.last_receipt_ns ? w.lastReceipt(ago(l.last_receipt_ns)) : w.noReceipt} /></dl>
  </${Card}>`;
}

// Passages that a person has to judge, each with what decides it.
function ReviewsCard({ t, onOpen }) {
  const rows = t.ledger?.reviews ?? [];
  const c = w.reviewColumns;
  const passage = (id) => t.ledger.recent.find((p) => p.passage_id === id);
  return html`<${Card} title=${w.reviews} id="reviews" class="reviews-card">
    ${!rows.length ? html`<p class="note block">${w.noReviews}</p>` : html`<div class="scroll" tabindex="0" role="group" aria-label=${w.reviews}><table class="plain"><thead><tr>${[c.time, c.lane, c.why, c.decides, c.sender].map((name) => html`<th scope="col">${name}</th>`)}</tr></thead>
    <tbody>${rows.map((r) => html`<tr key=${r.passage_id}><th scope="row">${passage(r.passage_id) ? html`<button class="link" onClick=${() => onOpen(passage(r.passage_id))}>${r.crossing_ns ? timeOfDay(r.crossing_ns / 1e6) : w.notCrossed}</button>` : r.crossing_ns ? timeOfDay(r.crossing_ns / 1e6) : w.notCrossed}</th>
      <td>${r.lane ?? words.age.bar}</td><td>${r.reason}${r.reversed && html`<span class="reason dim block">${w.reversed}</span>`}</td><td>${r.decided_by || words.age.bar}</td>
      <td>${r.authenticated ? w.authenticated : w.notAuthenticated}<span class="reason dim block">${w.contracts(r.contracts)}</span></td></tr>`)}</tbody></table></div>`}
  </${Card}>`;
}

// Which pictures the cameras keep, and until when; the pictures themselves are not here.
function PicturesCard({ t }) {
  const l = t.ledger;
  const rows = l?.pictures ?? [];
  const c = w.pictureColumns;
  return html`<${Card} title=${w.pictures} id="pictures" class="pictures-card" note=${l && w.picturesNote(l.pictures_kept, l.pictures_waiting, l.pictures_failed ?? 0)}>
    ${!rows.length ? html`<p class="note block">${w.noPictures}</p>` : html`<div class="scroll" tabindex="0" role="group" aria-label=${w.pictures}><table class="plain"><thead><tr>${[c.time, c.lane, c.why, c.until].map((name) => html`<th scope="col">${name}</th>`)}</tr></thead>
    <tbody>${rows.map((p) => html`<tr key=${`${p.lane}${p.pulse_ns}`}><th scope="row">${timeOfDay(p.pulse_ns / 1e6)}</th><td>${p.lane}</td><td>${p.reason}</td><td>${new Date(p.until_ns / 1e6).toISOString().slice(0, 10)}</td></tr>`)}</tbody></table></div>`}
  </${Card}>`;
}

function DeltaCard({ t }) {
  const d = t.delta;
  const stale = d && old("toll/delta", d.updated_ns);
  return html`<${Card} title=${w.delta} id="delta" class="delta-card" aside=${d && html`<${Age} topic="toll/delta" stamp=${d.updated_ns} />`}>
    ${!d ? html`<${Empty} title=${w.noDelta} why=${w.noDeltaWhy} />` : html`<dl class="rows ${stale ? "old" : ""}">
      <${Row} label=${w.deltaState} value=${d.valid ? w.valid : w.invalid} extra=${d.reason} />
      <${Row} label=${w.deltaNorth} value=${d.north_m == null ? words.age.bar : `${fixed(d.north_m, 2)} m`} /><${Row} label=${w.deltaEast} value=${d.east_m == null ? words.age.bar : `${fixed(d.east_m, 2)} m`} />
      <${Row} label=${w.deltaSd} value=${d.sd_m == null ? words.age.bar : metres(d.sd_m)} extra=${w.fixes(d.fixes)} /></dl>`}
    <dl class="rows"><${Row} label=${w.cams} value=${t.cams} extra=${w.batches(rate(t.cam_batches_hz))} /><${Row} label=${w.camRejects} value=${t.cam_rejects} />
      ${t.trust && html`<${Row} label=${w.antenna} value=${t.trust} />`}</dl>
  </${Card}>`;
}

function PassageDrawer({ passage: p, onClose }) {
  return html`<${Drawer} title=${w.drawer} onClose=${onClose}><dl class="rows">
    <${Row} label=${w.columns.state} value=${stateOf(p)} extra=${p.reason} /><${Row} label=${w.columns.lane} value=${p.lane ?? words.age.bar} extra=${p.probability == null ? null : percent(p.probability)} />
    <${Row} label=${w.columns.time} value=${p.crossing_ns ? timeOfDay(p.crossing_ns / 1e6, true) : w.notCrossed} /><${Row} label=${w.columns.amount} value=${amount(p.amount_cents, p.currency)} extra=${p.tariff_class} />
    ${p.state !== "missed" && html`<${Row} label=${w.passageId} value=${html`<code class="digest">${p.passage_id}</code>`} />`}${p.evidence_digest && html`<${Row} label=${w.evidence} value=${html`<code class="digest">${p.evidence_digest}</code>`} />`}
  </dl>
  ${explained(p) && html`<p class="note block">${explained(p)}</p>`}
  ${p.state === "charged" && html`<h3>${w.verify}</h3><p class="note block">${w.verifyHow}</p><p><code class="digest">obu verify-toll ledger.sqlite --passage ${p.passage_id}</code></p>`}</${Drawer}>`;
}

export function TollPage() {
  clock.value;
  link.value;
  const [open, setOpen] = useState(null);
  const t = state.value.toll;
  if (!t) return html`<div class="page"><${Card} title=${w.title} id="plaza"><${Empty} title=${w.otherRole} why=${w.otherRoleWhy} /></${Card}></div>`;
  return html`<div class="page toll-page"><${PlazaCard} t=${t} /><${LanesCard} t=${t} /><${PassagesCard} t=${t} onOpen=${setOpen} /><${DeltaCard} t=${t} /><${AccountCard} t=${t} /><${ReviewsCard} t=${t} onOpen=${setOpen} /><${PicturesCard} t=${t} />
    ${open && html`<${PassageDrawer} passage=${open} onClose=${() => setOpen(null)} />`}</div>`;
}
