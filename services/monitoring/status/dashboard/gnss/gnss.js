// The page GNSS: where satellites stand and how well they are received, which are used and why others are not, the kind
// of fix and the age of its corrections over time, and how the receiver is set.
import { useEffect, useState } from "preact/hooks";
import { clock, connected, freshness, nowMs, paused, remember, settings, state } from "../store.js";
import { Age, Card, Empty, KindsTable, Row, StateIcon, degrees, duration, fixed, html, monitorsStand, percent, rate, seconds } from "../parts.js";
import { gnssWords as w } from "./gnss_words.js";
import { words } from "../words.js";

const POLL_MS = 1000;
const TRACKS_MS = 30_000;
const R = 100; // radius of the horizon in the sky plot
const SPAN_S = 900;
const STRONG_DB_HZ = 45;
const WEAK_DB_HZ = 30;
const FULL_DB_HZ = 60;
const ORDER = Object.keys(w.constellation);
const OUTCOME = { pass: "safe", accuses: "unsafe", not_evaluated: "off" };
const FLAG = { unknown: "off", none: "safe", indicated: "caution", severe: "unsafe" };
const TOPICS = ["gnss/raw", "gnss/fix", "gnss/satellites", "gnss/signals", "gnss/raw_epoch", "gnss/navigation_bits", "gnss/signal_quality"];

function useAnswer(address, periodMs) {
  const [answer, setAnswer] = useState(null);
  useEffect(() => {
    let stopped = false;
    const ask = async () => {
      if (paused.value) return;
      try {
        const response = await fetch(address);
        const found = await response.json();
        if (!stopped && response.ok) setAnswer(found);
      } catch {
        // The shell says that the unit does not answer; the values here become stale by their age.
      }
    };
    ask();
    const timer = setInterval(ask, periodMs);
    return () => {
      stopped = true;
      clearInterval(timer);
    };
  }, [address]);
  return answer;
}

const useOf = (s) => (s.excluded ? "excluded" : s.used ? "used" : "tracked");

// Zenith in the middle, north up, east right.
function skyPoint(elevation, azimuth) {
  const r = R * (1 - Math.max(elevation, 0) / 90);
  const a = (azimuth * Math.PI) / 180;
  return [r * Math.sin(a), -r * Math.cos(a)];
}

// A shape for each constellation, so that colour is not the only difference.
function Shape({ constellation, size = 4.6 }) {
  const s = size;
  const polygon = (n, turn) => Array.from({ length: n }, (_, k) => {
    const a = turn + (2 * Math.PI * k) / n;
    return `${(s * 1.15 * Math.sin(a)).toFixed(2)},${(-s * 1.15 * Math.cos(a)).toFixed(2)}`;
  }).join(" ");
  if (constellation === "gps") return html`<circle r=${s} />`;
  if (constellation === "galileo") return html`<rect x=${-s * 0.9} y=${-s * 0.9} width=${s * 1.8} height=${s * 1.8} />`;
  if (constellation === "glonass") return html`<polygon points=${polygon(3, 0)} />`;
  if (constellation === "beidou") return html`<polygon points=${polygon(4, 0)} />`;
  if (constellation === "qzss") return html`<polygon points=${polygon(5, 0)} />`;
  if (constellation === "sbas") return html`<polygon points=${polygon(6, 0)} />`;
  return html`<polygon points=${polygon(3, Math.PI)} />`;
}

const ShapeKey = ({ constellation, kind = "tracked" }) => html`<svg class="sat-key" viewBox="-8 -8 16 16" width="18" height="18" aria-hidden="true">
  <g class="satellite ${kind} ${constellation}"><${Shape} constellation=${constellation} />${kind === "excluded" && html`<path class="cross" d="M-7-7 7 7M7-7-7 7" />`}</g></svg>`;

// Breaks a track where it crosses from one side of the sky to the other without a point between.
function trackPath(points) {
  return points.map(([el, az], i) => {
    const [x, y] = skyPoint(el, az);
    return `${i === 0 ? "M" : "L"}${x.toFixed(1)} ${y.toFixed(1)}`;
  }).join("");
}

// Where the name of each satellite is drawn: of the places around its symbol the one that covers least of other symbols and names.
const NAME_PLACES = [[0, -7], [0, 12.5], [13, 2.5], [-13, 2.5], [11, -5], [-11, -5], [11, 10], [-11, 10]];
const covered = ([ax, ay, aw, ah], [bx, by, bw, bh]) => Math.max(0, Math.min(ax + aw, bx + bw) - Math.max(ax, bx)) * Math.max(0, Math.min(ay + ah, by + bh) - Math.max(ay, by));

function namePlaces(points) {
  const taken = points.map(([x, y]) => [x - 5, y - 5, 10, 10]);
  return points.map(([x, y], own) => {
    const choices = NAME_PLACES.map(([dx, dy]) => {
      const box = [x + dx - 7, y + dy - 6, 14, 7.5]; // three characters of 7 px on their base line
      return { at: [dx, dy], box, cost: taken.reduce((sum, other, i) => sum + (i === own ? 0 : covered(box, other)), 0) };
    });
    const best = choices.reduce((a, b) => (b.cost < a.cost ? b : a));
    taken.push(best.box);
    return best.at;
  });
}

function Sky({ satellites, tracks, mask, trails }) {
  const placed = satellites.filter((s) => s.elevation_deg !== null && s.azimuth_deg !== null);
  const points = placed.map((s) => skyPoint(s.elevation_deg, s.azimuth_deg));
  const names = namePlaces(points);
  const count = (kind) => satellites.filter((s) => useOf(s) === kind).length;
  const described = w.skyLabel(count("used"), count("tracked"), count("excluded"));
  return html`<svg class="sky" viewBox="-118 -112 236 224" role="img" aria-label=${described}>
    ${[0, 30, 60].map((el) => html`<circle class="ring" r=${R * (1 - el / 90)} />`)}
    <path class="ring" d=${`M${-R} 0H${R}M0 ${-R}V${R}`} />
    ${mask > 0 && html`<circle class="mask" r=${R * (1 - mask / 90)} />`}
    ${[30, 60].map((el) => html`<text class="scale-text" x="3" y=${-R * (1 - el / 90) + 8}>${el}°</text>`)}
    ${Object.entries(w.compass).map(([name, [x, y]]) => html`<text class="compass" x=${x * 108} y=${y * 107 + 4}>${name}</text>`)}
    ${trails && placed.map((s) => (tracks[s.name]?.length > 1 ? html`<path key=${`t${s.name}`} class="track-line ${useOf(s)}" d=${trackPath([...tracks[s.name], [s.elevation_deg, s.azimuth_deg]])} />` : null))}
    ${placed.map((s, i) => {
      const [x, y] = points[i];
      return html`<g key=${s.name} class="satellite ${useOf(s)} ${s.constellation}" transform=${`translate(${x.toFixed(1)} ${y.toFixed(1)})`}>
        ${s.suspect && html`<circle class="suspect" r="8" />`}
        <${Shape} constellation=${s.constellation} />${s.excluded && html`<path class="cross" d="M-7-7 7 7M7-7-7 7" />`}</g>`;
    })}
    ${placed.map((s, i) => html`<text key=${`n${s.name}`} x=${points[i][0] + names[i][0]} y=${points[i][1] + names[i][1]}>${s.name}</text>`)}
  </svg>`;
}

const reasonOf = (s) => [s.reason, s.integrity].filter(Boolean).join(", ");

function SatelliteTable({ satellites }) {
  const [order, setOrder] = useState("name");
  const keys = { name: (s) => s.name, elevation: (s) => -(s.elevation_deg ?? -91), cn0: (s) => -(s.cn0_db_hz ?? -1), use: (s) => ({ excluded: 0, tracked: 1, used: 2 }[useOf(s)]) };
  const sorted = [...satellites].sort((a, b) => (keys[order](a) > keys[order](b) ? 1 : keys[order](a) < keys[order](b) ? -1 : a.name > b.name ? 1 : -1));
  const head = (name, label, extra = "") => html`<th scope="col" class=${extra} aria-sort=${order === name ? "ascending" : null}><button class="link" onClick=${() => setOrder(name)}>${label}</button></th>`;
  return html`<div class="scroll sat-table" tabindex="0" role="group" aria-label=${w.satellites}><table class="plain">
    <thead><tr>${head("name", w.columns.name)}${head("elevation", w.columns.elevation, "number")}<th scope="col" class="number">${w.columns.azimuth}</th>${head("cn0", w.columns.cn0, "number")}<th scope="col" class="number wide-only">${w.columns.residual}</th>${head("use", w.columns.use)}<th scope="col" class="wide-only">${w.columns.why}</th></tr></thead>
    <tbody>${sorted.map((s) => html`<tr key=${s.name}><th scope="row"><span class="with-icon"><${ShapeKey} constellation=${s.constellation} kind=${useOf(s)} />${s.name}</span></th>
      <td class="number">${s.elevation_deg === null ? "-" : `${Math.round(s.elevation_deg)}°`}</td><td class="number">${s.azimuth_deg === null ? "-" : `${Math.round(s.azimuth_deg)}°`}</td>
      <td class="number">${fixed(s.cn0_db_hz, 0)}</td><td class="number wide-only">${fixed(s.residual_m, 1)}</td>
      <td>${w.use[useOf(s)]}<span class="narrow-only note">${reasonOf(s)}</span></td><td class="wide-only">${reasonOf(s)}</td></tr>`)}</tbody></table></div>`;
}

function SkyCard({ receiver, tracks }) {
  const [table, setTable] = useState(false);
  const satellites = receiver.satellites;
  const trails = settings.value.skyTrails ?? true;
  const mask = receiver.configuration?.elevation_mask_rad == null ? 0 : degrees(receiver.configuration.elevation_mask_rad);
  const present = ORDER.filter((name) => satellites.some((s) => s.constellation === name));
  const old = freshness("gnss/satellites", receiver.updated_ns.satellites) === "stale";
  const count = (kind) => satellites.filter((s) => useOf(s) === kind).length;
  const aside = html`<${Age} topic="gnss/satellites" stamp=${receiver.updated_ns.satellites} /> ${satellites.length > 0 && html`<button class="link" aria-pressed=${table} onClick=${() => setTable(!table)}>${table ? words.closeup.picture : words.closeup.table}</button>`}`;
  return html`<${Card} title=${w.sky} note=${w.skyNote(count("used"), satellites.length, count("excluded"))} id="sky" class=${`sky-card ${old ? "old" : ""}`} aside=${aside}>
    ${satellites.length === 0 ? html`<${Empty} title=${w.noSatellites} why=${w.noSatellitesWhy} />`
      : table ? html`<${SatelliteTable} satellites=${satellites} />` : html`<${Sky} satellites=${satellites} tracks=${tracks} mask=${mask} trails=${trails} />`}
    ${satellites.length > 0 && !table && html`<ul class="legend">${present.map((name) => html`<li><${ShapeKey} constellation=${name} />${w.constellation[name]}</li>`)}</ul>
    <ul class="legend"><li><${ShapeKey} constellation="gps" kind="used" />${w.use.used}</li><li><${ShapeKey} constellation="gps" />${w.use.tracked}</li><li><${ShapeKey} constellation="gps" kind="excluded" />${w.use.excluded}</li>
      ${mask > 0 && html`<li><svg class="line-key" width="24" height="8" aria-hidden="true"><path class="mask" d="M1 4H23" /></svg>${w.mask(Math.round(mask))}</li>`}
      <li><label class="switch small"><input type="checkbox" checked=${trails} onChange=${(e) => remember({ skyTrails: e.target.checked })} /> ${w.trails}</label></li></ul>`}
  </${Card}>`;
}

// The signals of a satellite; without any, its C/N0 alone. Receivers that state no use of a signal state that of the satellite.
function signalsOf(s) {
  const given = s.signals.length > 0 ? [...s.signals].sort((a, b) => (a.band > b.band ? 1 : -1)) : [{ band: w.anySignal, cn0_db_hz: s.cn0_db_hz, used: null, reason: null }];
  return given.map((g) => ({ ...g, used: !s.excluded && (g.used ?? s.used), reason: s.used && !s.excluded ? g.reason : null }));
}

// Of each signal of a constellation: how many are used, and their mean C/N0.
function bandsOf(list) {
  const bands = new Map();
  for (const g of list.flatMap(signalsOf)) bands.set(g.band, [...(bands.get(g.band) ?? []), g]);
  return [...bands].sort().map(([band, all]) => {
    const received = all.filter((g) => g.cn0_db_hz !== null);
    const mean = received.length > 0 ? received.reduce((sum, g) => sum + g.cn0_db_hz, 0) / received.length : null;
    return w.band(band, all.filter((g) => g.used).length, all.length, mean?.toFixed(0));
  });
}

// One bar a signal: filled if it is used, hatched if not.
function SignalsCard({ receiver }) {
  const satellites = receiver.satellites.filter((s) => s.cn0_db_hz !== null || s.signals.length > 0);
  const groups = ORDER.map((name) => [name, satellites.filter((s) => s.constellation === name)]).filter(([, list]) => list.length > 0);
  const strongest = groups.map(([name, list]) => [name, Math.max(...list.flatMap(signalsOf).map((g) => g.cn0_db_hz ?? 0))]);
  const described = w.signalsLabel(strongest.map(([name, v]) => `${w.constellation[name]} ${v.toFixed(0)} dBHz`).join(", "));
  const all = satellites.flatMap((s) => s.signals);
  return html`<${Card} title=${w.signals} note=${w.signalsNote} id="signals" fold class="signals-card">
    ${groups.length === 0 ? html`<${Empty} title=${w.noSignals} why=${w.noSignalsWhy} />` : html`
    <div class="bars" role="group" aria-label=${described}>${groups.map(([name, list]) => html`<div class="bar-group" key=${name}><h3><${ShapeKey} constellation=${name} />${w.constellation[name]}</h3>
      <p class="note">${bandsOf(list).join("; ")}</p>
      <ul>${list.map((s) => html`<li key=${s.name} class=${useOf(s)}><span class="sat-name">${s.name}</span>${signalsOf(s).map((g) => html`<span class="signal ${g.used ? "used" : ""}" key=${g.band}>
        <span class="signal-name">${g.band}</span><span class="level"><span class="fill" style=${{ width: `${Math.min((g.cn0_db_hz ?? 0) / FULL_DB_HZ, 1) * 100}%` }}></span></span><span class="value">${fixed(g.cn0_db_hz, 0)}</span>
        ${g.reason && html`<span class="why note">${g.reason}</span>`}</span>`)}
        ${useOf(s) !== "used" && html`<span class="why note">${reasonOf(s)}</span>`}</li>`)}</ul></div>`)}</div>
    <ul class="legend"><li><span class="bar-key used"></span>${w.use.used}</li><li><span class="bar-key tracked"></span>${w.notUsed}</li><li class="dim">${w.ticks(WEAK_DB_HZ, STRONG_DB_HZ)}</li></ul>
    <p class="note block">${all.length === 0 ? w.perSatellite : all.some((g) => g.used !== null) ? w.perSignal : w.perMeasurement}</p>`}
  </${Card}>`;
}

function StateBand({ title, changes, names, group }) {
  const nowNs = nowMs() * 1e6;
  const from = nowNs - SPAN_S * 1e9;
  const spans = changes.map((c, i) => ({ ...c, from: Math.max(c.since_ns, from), to: changes[i + 1]?.since_ns ?? nowNs })).filter((s) => s.to > from);
  const share = (ns) => `${((100 * ns) / (SPAN_S * 1e9)).toFixed(3)}%`;
  const described = spans.slice(-6).map((s) => `${names[s.state] ?? s.state} ${duration((s.to - s.from) / 1e9)}`).join(", ");
  const now = spans.at(-1);
  const present = [...new Set(spans.map((s) => s.state))];
  return html`<div class="state-band"><p><strong>${title}</strong> <span>${now ? names[now.state] ?? now.state : w.noBand}</span>${now && html`<span class="dim"> ${words.banner.since(duration(Math.max(0, (nowNs - changes.at(-1).since_ns) / 1e9)))}</span>`}</p>
    <div class="band" role="img" aria-label=${w.bandLabel(title, described)}>${spans.map((s) => html`<span class="segment ${group}-${s.state}" style=${{ left: share(s.from - from), width: share(s.to - s.from) }}></span>`)}</div>
    <ul class="legend">${present.map((name) => html`<li><span class="bar-key ${group}-${name}"></span>${names[name] ?? name}</li>`)}</ul></div>`;
}

function FixCard({ receiver, corrections }) {
  const { fix, bands } = receiver;
  const p = words.position;
  const stale = freshness("gnss/fix", receiver.updated_ns.fix) === "stale";
  return html`<${Card} title=${w.fix} note=${w.fixNote} id="fix-over-time" class="fix-card" aside=${html`<${Age} topic="gnss/fix" stamp=${receiver.updated_ns.fix} />`}>
    ${!fix ? html`<${Empty} title=${w.noFix} why=${w.noFixWhy} />` : html`
    <${StateBand} title=${w.kind} group="fix" changes=${bands.fix} names=${w.kinds} />
    <${StateBand} title=${p.correction} group="correction" changes=${bands.correction} names=${w.corrections} />
    <p class="axis" aria-hidden="true"><span>${words.trustCard.ago}</span><span>${words.trustCard.now}</span></p>
    <dl class="rows ${stale ? "old" : ""}">
      <${Row} label=${w.dop} value=${[["PDOP", fix.pdop], ["HDOP", fix.hdop], ["VDOP", fix.vdop]].map(([n, v]) => `${n} ${fixed(v, 1)}`).join("  ")} />
      <${Row} label=${w.correctionAge} value=${fix.correction_age_s === null ? p.correctionNone : `${fixed(fix.correction_age_s, 1)} s`} extra=${fix.correction_age_s === null ? null : w.correctionNote} />
      ${corrections && html`<${Row} label=${w.correctionSource} value=${corrections.active ?? p.correctionNone} extra=${corrections.active ? [p.carrier[fix.carrier_solution], w.correctionFrames(Object.values(corrections.types).reduce((a, b) => a + b, 0))].filter(Boolean).join(", ") : corrections.reason} />`}
      <${Row} label=${w.firstFix} value=${receiver.first_fix_s === null ? w.notKnown : seconds(receiver.first_fix_s)} extra=${receiver.first_fix_s === null ? null : w.firstFixNote} />
      ${fix.baseline_heading_rad !== null && html`<${Row} label=${w.baseline} value=${`${fixed((degrees(fix.baseline_heading_rad) + 360) % 360, 1)}°`} extra=${fix.baseline_length_m === null ? null : `${fixed(fix.baseline_length_m, 2)} m`} />`}
    </dl>
    <p class="note block"><a href="#/charts">${w.chartsLink}</a></p>`}
  </${Card}>`;
}

const Flag = ({ value, old }) => html`<${StateIcon} state=${old ? "stale" : FLAG[value ?? "unknown"]} word="" /> ${w.flags[value ?? "unknown"]}`;

function InterferenceCard({ receiver }) {
  clock.value;
  const q = receiver.quality;
  const monitor = state.value.trust.monitors.evidence;
  const tests = monitor ? Object.entries(monitor.tests) : [];
  const old = !connected() || (q && freshness("gnss/fix", receiver.updated_ns.quality) === "stale");
  const number = (v) => (v === null ? "-" : Math.abs(v) < 1e-3 && v !== 0 ? "< 0.001" : String(+v.toPrecision(3)));
  return html`<${Card} title=${w.interference} note=${w.interferenceNote} id="interference" class="interference-card" aside=${q && html`<${Age} topic="gnss/fix" stamp=${receiver.updated_ns.quality} />`}>
    ${!q ? html`<${Empty} title=${w.noQuality} why=${w.noQualityWhy} />` : html`<dl class="rows ${old ? "old" : ""}">
      <${Row} label=${w.spoofing} value=${html`<${Flag} old=${old} value=${q.security?.spoofing ?? q.status?.spoofing} />`} extra=${q.security ? "UBX-SEC-SIG" : q.status ? "UBX-NAV-STATUS" : null} />
      <${Row} label=${w.jamming} value=${html`<${Flag} old=${old} value=${q.security?.jamming ?? worst(q.radio_paths)} />`} extra=${q.security ? "UBX-SEC-SIG" : q.radio_paths.length > 0 ? "UBX-MON-RF" : null} />
      ${q.radio_paths.map((path) => html`<${Row} label=${w.path(path.number)} value=${w.gain(percent(path.gain_ratio))} extra=${w.pathNote(path.noise_level, percent(path.narrowband_ratio))} />`)}
      ${q.clock && html`<${Row} label=${w.clock} value=${`${(q.clock.bias_s * 1e6).toFixed(1)} µs`} extra=${w.drift((q.clock.drift_ratio * 1e9).toFixed(0))} />`}
    </dl>`}
    ${tests.length > 0 && html`<h3 class="divide">${w.evidence}</h3><div class="scroll" tabindex="0" role="group" aria-label=${w.evidence}><table class="plain"><thead><tr><th scope="col">${w.test}</th><th scope="col" class="number">${w.statistic}</th><th scope="col" class="wide-only">${w.columns.why}</th></tr></thead>
      <tbody>${tests.map(([name, t]) => html`<tr key=${name}><th scope="row"><span class="with-icon"><${StateIcon} state=${monitorsStand() ? OUTCOME[t.outcome] : "stale"} word=${words.trustPage.outcome[monitorsStand() ? t.outcome : "stale"]} />${t.label}</span></th>
        <td class="number">${t.statistic === null ? "-" : `${number(t.statistic)} ${words.trustPage.of} ${number(t.threshold)}`}</td><td class="wide-only">${t.reason}</td></tr>`)}</tbody></table></div>
    <p class="note block">${w.evidenceNote}</p>`}
  </${Card}>`;
}

const worst = (paths) => ["severe", "indicated", "none", "unknown"].find((name) => paths.some((p) => p.jamming === name)) ?? "unknown";

const PORT_STATE = { working: "safe", searching: "starting", absent: "unsafe", silent: "unsafe", noise: "unsafe", other: "caution" };

function ReceiverCard({ receiver, kinds }) {
  const c = receiver.configuration;
  const d = receiver.device;
  const said = receiver.said;
  const flows = TOPICS.map((name) => [name, state.value.topics[name]]).filter(([, flow]) => flow?.updated_ns != null);
  return html`<${Card} title=${w.receiver} note=${receiver.source} id="receiver" fold class="receiver-card">
    <dl class="rows">
      ${d && html`<${Row} label=${w.port} value=${html`<${StateIcon} state=${connected() ? PORT_STATE[d.found] : "stale"} word="" /> ${w.found[d.found]}`} extra=${d.sentence || d.device} />`}
      ${said && html`<${Row} label=${w.sends} value=${said.messages.length > 0 ? said.messages.join(", ") : w.noMessages} extra=${said.other_protocols.length > 0 ? w.other(said.other_protocols.join(", ")) : said.gives_position ? null : w.noPosition} />`}
      <${Row} label=${w.model} value=${c?.model ?? w.notStated} />
      <${Row} label=${w.firmware} value=${c?.firmware ?? w.notStated} />
      ${c && html`<${Row} label=${w.settings} value=${html`<${StateIcon} state=${!connected() ? "stale" : c.accepted ? "safe" : "caution"} word="" /> ${c.accepted ? w.accepted : w.rejected}`} extra=${c.reason} />
      <${Row} label=${w.period} value=${c.navigation_period_s === null ? w.notStated : seconds(c.navigation_period_s)} />
      <${Row} label=${w.dynamic} value=${c.dynamic_model ?? w.notStated} />
      <${Row} label=${w.maskRow} value=${c.elevation_mask_rad === null ? w.notStated : `${Math.round(degrees(c.elevation_mask_rad))}°`} />
      <${Row} label=${w.messages} value=${c.messages.length > 0 ? c.messages.join(", ") : w.notStated} />`}
      ${!c && html`<${Row} label=${w.settings} value=${w.notRead} extra=${w.notReadWhy} />`}
    </dl>
    <${KindsTable} kinds=${kinds} />
    ${flows.length > 0 && html`<h3 class="divide">${w.received}</h3><ul class="tags">${flows.map(([name, flow]) => html`<li><a href=${`#/system?topic=${name}`}>${name} ${rate(flow.rate_hz)}/s</a></li>`)}</ul>`}
  </${Card}>`;
}

export function GnssPage() {
  clock.value;
  const answer = useAnswer("api/gnss", POLL_MS);
  const tracks = useAnswer("api/gnss/tracks", TRACKS_MS) ?? {};
  const [chosen, setChosen] = useState(null);
  if (!answer) return html`<p class="note">${w.loading}</p>`;
  const sources = answer.receivers.map((r) => r.source).sort();
  const receiver = answer.receivers.find((r) => r.source === chosen) ?? answer.receivers[0];
  if (!receiver) return html`<div class="page gnss-page"><${Card} title=${w.title} id="no-receiver" class="whole"><${Empty} title=${w.empty} why=${w.emptyWhy} what=${html`<a href="#/system?node=parsers.gnss">${w.emptyLink}</a>`} /></${Card}></div>`;
  return html`<div class="page gnss-page">
    ${sources.length > 1 && html`<div class="toolbar whole" role="group" aria-label=${w.receivers}>${sources.map((name) => html`<button key=${name} aria-pressed=${name === receiver.source} onClick=${() => setChosen(name)}>${name}</button>`)}</div>`}
    <div class="stack"><${SkyCard} receiver=${receiver} tracks=${tracks[receiver.source] ?? {}} /><${FixCard} receiver=${receiver} corrections=${answer.corrections} /></div>
    <div class="stack"><${SignalsCard} receiver=${receiver} /><${InterferenceCard} receiver=${receiver} /><${ReceiverCard} receiver=${receiver} kinds=${answer.kinds} /></div>
  </div>`;
}
