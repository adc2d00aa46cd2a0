// The page Trust: the verdict and why, every monitor with its statistic against its threshold, and how both went.
import { useEffect, useMemo, useState } from "preact/hooks";
import { brokerAnswers, clock, link, nowMs, paused, state } from "../store.js";
import {
  Band, Card, Empty, Icon, Row, SPAN_S, StateIcon, bandsOf, duration, html, metres, timeOfDay, verdict, monitorsStand,
} from "../parts.js";
import { AttacksCard } from "./attacks.js";
import { CrossingCard, TachographCard } from "./records.js";
import { HypothesesCard, hypothesesNow, probability } from "./hypotheses.js";
import { w as hypothesisWords } from "./hypothesis_words.js";
import { words } from "../words.js";

const w = words.trustPage;
const RENEW_MS = 5000;
const STRIP = { width: 900, height: 40, limit: 2, decades: 6 }; // the limit is in the middle: twice the threshold is the upper edge
const GAP_NS = 3e9; // a longer pause between samples breaks the line
const OUTCOME_STATE = { pass: "safe", accuses: "unsafe", not_evaluated: "off" };

const figure = (value) => (value == null ? words.age.bar : Number(value.toPrecision(3)).toLocaleString("en"));
const chance = (value) => (value == null ? words.age.bar : value < 0.001 ? value.toExponential(0).replace("e-", " × 10⁻").replace(/⁻(\d+)/, (_, n) => `⁻${[...n].map((d) => "⁰¹²³⁴⁵⁶⁷⁸⁹"[d]).join("")}`) : String(value));
const sinceText = (ns) => {
  const age = ns == null || nowMs() === null ? null : (nowMs() - ns / 1e6) / 1000;
  return age === null ? words.age.bar : w.at(timeOfDay(ns / 1e6), duration(Math.max(0, age)));
};
const monitorsNow = () => Object.entries(state.value.trust.monitors);

// One outcome: an old verdict holds for no monitor any more.
function outcomeOf(shown) {
  return monitorsStand() ? [OUTCOME_STATE[shown.outcome], w.outcome[shown.outcome]] : ["stale", w.outcome.stale];
}

function Outcome({ shown }) {
  const [icon, word] = outcomeOf(shown);
  const who = monitorsStand() && shown.accused;
  return html`<span class="with-icon outcome ${icon}"><${StateIcon} state=${icon} word="" /><strong>${word}${who && ` ${who}`}</strong></span>
    <span class="reason dim">${shown.reason}</span>`;
}

// Statistic against threshold; the bar ends at twice the threshold, which is its mark in the middle.
function Statistic({ shown }) {
  const unit = shown.unit && shown.unit !== "-" ? ` ${shown.unit}` : "";
  const live = monitorsStand() && shown.outcome !== "not_evaluated";
  if (shown.statistic == null || !live) {
    return html`<span class="dim">${shown.threshold == null ? words.age.bar : w.limitOnly(`${figure(shown.threshold)}${unit}`)}</span>`;
  }
  return html`<span class="numbers"><strong>${figure(shown.statistic)}</strong> ${w.of} ${shown.threshold == null ? words.age.bar : `${figure(shown.threshold)}${unit}`}</span>
    ${shown.ratio !== null && html`<span class="meter ${shown.ratio > 1 ? "over" : ""}" aria-hidden="true"><span class=${OUTCOME_STATE[shown.outcome]} style=${{ width: `${Math.min(shown.ratio / 2, 1) * 100}%` }}></span></span>`}`;
}

function TestsTable({ tests, label }) {
  const c = w.columns;
  return html`<div class="scroll" tabindex="0" role="group" aria-label=${w.testsOf(label)}><table class="plain tests">
    <thead><tr><th scope="col">${c.test}</th><th scope="col">${c.outcome}</th><th scope="col">${c.statistic}</th><th scope="col" class="wide-only">${c.falseAlarm}</th><th scope="col" class="wide-only">${c.window}</th><th scope="col" class="wide-only">${c.since}</th></tr></thead>
    <tbody>${tests.map(([name, t]) => html`<tr key=${name}><th scope="row">${t.label}</th><td><${Outcome} shown=${t} /></td><td><${Statistic} shown=${t} /></td>
      <td class="wide-only">${chance(t.false_alarm_rate)}</td><td class="wide-only">${t.window_s == null ? words.age.bar : duration(t.window_s)}</td><td class="wide-only">${sinceText(t.since_ns)}</td></tr>`)}</tbody>
  </table></div>`;
}

function Monitor({ name, shown, open, onToggle }) {
  const tests = Object.entries(shown.tests);
  const c = w.columns;
  const facts = [[c.falseAlarm, chance(shown.false_alarm_rate)], [c.window, shown.window_s == null ? words.age.bar : duration(shown.window_s)], [c.since, sinceText(shown.since_ns)], [c.suspect, monitorsStand() ? sinceText(shown.suspect_since_ns) : words.age.bar]];
  return html`<tr class=${monitorsStand() ? "" : "old"}>
      <th scope="row"><button class="link fold" aria-expanded=${open} aria-controls=${`tests-${name}`} onClick=${onToggle}><${Icon} name="next" />${shown.label}</button>
        <span class="reason dim">${w.monitors[name] ?? ""}</span></th>
      <td><${Outcome} shown=${shown} /></td><td><${Statistic} shown=${shown} /></td>
      ${facts.map(([, value]) => html`<td class="wide-only">${value}</td>`)}
    </tr>
    <tr class="folded" id=${`tests-${name}`} hidden=${!open}><td colspan="7">${open && html`
      <dl class="rows narrow-only">${facts.map(([label, value]) => html`<${Row} label=${label} value=${value} />`)}</dl>
      ${tests.length ? html`<${TestsTable} tests=${tests} label=${shown.label} />` : html`<p class="note block">${w.noTests}</p>`}`}</td></tr>`;
}

function MonitorsCard({ query, go }) {
  const [open, setOpen] = useState({});
  const asked = query.get("monitor");
  useEffect(() => {
    if (asked) setOpen((now) => ({ ...now, [asked]: true }));
  }, [asked]);
  const rows = monitorsNow();
  const c = w.columns;
  if (!rows.length) return html`<${Card} title=${w.monitorsTitle} id="monitors" class="monitors-card"><${Empty} title=${w.emptyMonitors} why=${w.emptyMonitorsWhy} /></${Card}>`;
  const toggle = (name) => {
    if (asked) go("#/trust");
    setOpen((now) => ({ ...now, [name]: !now[name] }));
  };
  return html`<${Card} title=${w.monitorsTitle} note=${monitorsStand() ? w.monitorsNote : w.monitorsOld} id="monitors" fold=${!asked && !rows.some(([, shown]) => shown.outcome === "accuses")} class="monitors-card">
    <div class="scroll" tabindex="0" role="group" aria-label=${w.monitorsTitle}><table class="plain monitors"><thead><tr>${["monitor", "outcome", "statistic"].map((name) => html`<th scope="col">${c[name]}</th>`)}
      ${["falseAlarm", "window", "since", "suspect"].map((name) => html`<th scope="col" class="wide-only">${c[name]}</th>`)}</tr></thead>
      <tbody>${rows.map(([name, shown]) => html`<${Monitor} key=${name} name=${name} shown=${shown} open=${Boolean(open[name])} onToggle=${() => toggle(name)} />`)}</tbody></table></div>
  </${Card}>`;
}

function VerdictCard() {
  const v = verdict();
  const t = state.value.trust.verdict;
  const stands = monitorsStand() && t;
  const limits = stands ? [["horizontal", t.protection_level_horizontal_m, t.alert_limit_horizontal_m], ["vertical", t.protection_level_vertical_m, t.alert_limit_vertical_m]] : [];
  return html`<${Card} title=${w.verdictTitle} id="verdict" class="verdict-card" aside=${stands && html`<span class="note">${w.row(t.row)}</span>`}>
    <p class="chip ${v.state}"><${Icon} name=${v.state} /><strong>${v.word}</strong>${stands && html`<span>${w.since(sinceText(t.since_ns))}</span>`}</p>
    <h3>${words.banner.why}</h3>
    ${stands ? html`<ol class="reasons">${t.reasons.map((reason) => html`<li>${reason}</li>`)}</ol>` : html`<p class="lead-text">${v.sentence}</p>`}
    ${stands && t.findings.length > 0 && html`<h3>${w.findings}</h3><ul class="reasons">${t.findings.map((finding) => html`<li>${finding}</li>`)}</ul>`}
    ${stands && html`<dl class="rows">
      ${limits.map(([axis, level, limit]) => html`<${Row} label=${w.level[axis]} value=${metres(level)} extra=${w.alertLimit(metres(limit))} />`)}
      <${Row} label=${w.gnss} value=${t.gnss_excluded ? w.excluded : t.suspect_since_ns != null ? w.inConflict : w.notExcluded} extra=${t.suspect_since_ns != null ? w.suspect(sinceText(t.suspect_since_ns)) : null} />
      <${Row} label=${w.odometer} value=${t.odometer_excluded ? w.excluded : w.notExcluded} />
      <${Row} label=${w.imu} value=${t.imu_excluded ? w.excluded : w.notExcluded} />
    </dl>`}
    ${v.action && html`<h3>${words.banner.action}</h3><p>${v.action}</p>`}
  </${Card}>`;
}

function EventsCard() {
  const events = state.value.trust.events;
  return html`<${Card} title=${w.eventsTitle} note=${w.eventsNote} id="events" fold class="events-card">
    ${!events.length ? html`<p class="note block">${w.noEvents}</p>` : html`<ol class="outages events scroll" tabindex="0" aria-label=${w.eventsTitle}>${events.map((e) => html`<li key=${e.sampled_ns}>
      <span><${StateIcon} state=${e.before} /> <span class="sr">${w.to}</span><${Icon} name="next" /> <${StateIcon} state=${e.after} word="" /><strong>${words.trust[e.after]}</strong></span>
      <time>${timeOfDay(e.sampled_ns / 1e6)}</time>
      <span class="dim">${e.reasons[0]}${e.accusing.map((m) => html`<br />${w.evidence(m.monitor, m.accused, figure(m.statistic), figure(m.threshold))}`)}</span>
    </li>`)}</ol>`}
  </${Card}>`;
}

// The last quarter of an hour, renewed every few seconds: the verdict as a band, each monitor as a line.
function useHistory() {
  const [history, setHistory] = useState(null);
  useEffect(() => {
    let gone = false;
    const renew = async () => {
      if (paused.value) return;
      try {
        const answer = await fetch(`api/trust?seconds=${SPAN_S}`, { signal: AbortSignal.timeout(RENEW_MS) });
        if (answer.ok && !gone) setHistory((await answer.json()).history);
      } catch {
        // The connection is lost, which the bar above says; the last history stays and moves to the left.
      }
    };
    renew();
    const timer = setInterval(renew, RENEW_MS);
    return () => {
      gone = true;
      clearInterval(timer);
    };
  }, [link.value.open, paused.value]);
  return history;
}

const ofRatio = (ratio) => Math.min(ratio, STRIP.limit) / STRIP.limit; // share of the height
const ofProbability = (p) => Math.max(0, 1 + Math.log10(Math.max(p, 1e-9)) / STRIP.decades);

function pathOf(times, ratios, nowNs, share = ofRatio) {
  const x = (ns) => ((ns - nowNs) / (SPAN_S * 1e9) + 1) * STRIP.width;
  const y = (ratio) => STRIP.height * (1 - share(ratio));
  let path = "";
  let last = null;
  times.forEach((ns, i) => {
    if (ratios[i] == null) last = null;
    else {
      const at = `${x(ns).toFixed(1)} ${y(ratios[i]).toFixed(1)}`;
      path += last === null || ns - last > GAP_NS ? `M${at}h.6` : `L${at}`;
      last = ns;
    }
  });
  return path;
}

const largest = (values) => values.reduce((most, v) => (v != null && (most === null || v > most) ? v : most), null);

function Strip({ label, times, ratios }) {
  const path = useMemo(() => pathOf(times, ratios, times.at(-1)), [times]);
  const known = ratios.filter((r) => r != null);
  const newest = monitorsStand() ? ratios.at(-1) ?? null : null;
  const most = largest(ratios);
  const text = known.length ? w.stripText(newest === null ? null : newest.toFixed(2), most.toFixed(2), known.filter((r) => r > 1).length) : w.neverEvaluated;
  return html`<div class="strip"><p class="strip-label">${label}<span class="dim">${!monitorsStand() ? w.outcome.stale : newest === null ? w.outcome.not_evaluated : w.ofThreshold(newest.toFixed(2))}</span></p>
    <svg viewBox="0 0 ${STRIP.width} ${STRIP.height}" preserveAspectRatio="none" role="img" aria-label=${`${label}: ${text}`}>
      <path class="limit" d="M0 ${STRIP.height / 2}H${STRIP.width}" /><path class=${most > 1 ? "line over" : "line"} d=${path} /></svg></div>`;
}

// A probability on a logarithmic scale: a hypothesis that grows from one in a million to certainty crosses the whole height.
function ProbabilityStrip({ label, times, values }) {
  const path = useMemo(() => pathOf(times, values, times.at(-1), ofProbability), [times]);
  const newest = monitorsStand() ? values.at(-1) ?? null : null;
  const shown = newest === null ? null : probability(newest);
  return html`<div class="strip"><p class="strip-label">${label}<span class="dim">${shown === null ? w.outcome.stale : hypothesisWords.history(shown)}</span></p>
    <svg viewBox="0 0 ${STRIP.width} ${STRIP.height}" preserveAspectRatio="none" role="img" aria-label=${`${label}: ${hypothesisWords.historyText(shown, probability(largest(values)))}`}>
      <path class=${newest > 0.5 ? "line over" : "line"} d=${path} /></svg></div>`;
}

function HistoryTable({ rows, bands }) {
  const c = w.history;
  const share = (ratios) => `${Math.round((100 * ratios.filter((r) => r != null).length) / Math.max(ratios.length, 1))} %`;
  return html`<div class="scroll" tabindex="0" role="group" aria-label=${w.historyTitle}><table class="plain"><thead><tr>${[c.monitor, c.newest, c.largest, c.evaluated].map((name) => html`<th scope="col">${name}</th>`)}</tr></thead>
    <tbody>${rows.map(([, label, ratios]) => html`<tr><th scope="row">${label}</th><td>${ratios.at(-1)?.toFixed(2) ?? w.outcome.not_evaluated}</td><td>${largest(ratios)?.toFixed(2) ?? words.age.bar}</td><td>${share(ratios)}</td></tr>`)}</tbody></table>
    <table class="plain"><thead><tr><th scope="col">${c.verdict}</th><th scope="col">${c.from}</th><th scope="col">${c.length}</th></tr></thead>
    <tbody>${bands.slice().reverse().slice(0, 50).map((b) => html`<tr><th scope="row">${words.trust[b.state]}</th><td>${timeOfDay(b.from / 1e6)}</td><td>${duration((b.to - b.from) / 1e9)}</td></tr>`)}</tbody></table></div>`;
}

function HistoryCard() {
  const history = useHistory();
  const [table, setTable] = useState(false);
  const nowNs = state.value.now_ns;
  const bands = bandsOf(state.value.timeline, nowNs);
  const seen = [...new Set(bands.map((b) => b.state))];
  const total = (name) => bands.filter((b) => b.state === name).reduce((sum, b) => sum + (b.to - b.from) / 1e9, 0);
  const rows = monitorsNow().map(([name, m]) => [name, m.label, history?.ratios[name] ?? []]);
  const beliefs = hypothesesNow().filter(([name]) => name !== "nothing" && history?.probabilities[name]);
  return html`<${Card} title=${w.historyTitle} note=${words.trustCard.span} id="trust-history" fold class="history-card"
    aside=${html`<button class="link" aria-pressed=${table} onClick=${() => setTable(!table)}>${table ? words.closeup.picture : words.closeup.table}</button>`}>
    ${table ? html`<${HistoryTable} rows=${rows} bands=${bands} />` : html`<div class="strips">
      <div class="strip"><p class="strip-label">${w.verdictTitle}</p><${Band} bands=${bands} nowNs=${nowNs} /></div>
      ${rows.map(([name, label, ratios]) => html`<${Strip} key=${name} label=${label} times=${history?.time_ns ?? []} ratios=${ratios} />`)}
      ${beliefs.map(([name, row]) => html`<${ProbabilityStrip} key=${name} label=${row.label} times=${history.time_ns} values=${history.probabilities[name]} />`)}
      <p class="axis" aria-hidden="true"><span>${words.trustCard.ago}</span><span>${words.trustCard.now}</span></p></div>
    <p class="note block">${w.stripNote}${beliefs.length > 0 && ` ${hypothesisWords.historyNote}`}</p>`}
    <ul class="legend">${seen.map((name) => html`<li><${StateIcon} state=${name} word="" /><span>${words.trust[name]}</span><span class="dim">${duration(total(name))}</span></li>`)}</ul>
  </${Card}>`;
}

export function TrustPage({ query, go }) {
  clock.value;
  link.value;
  brokerAnswers();
  return html`<div class="page trust-page"><${VerdictCard} /><${HistoryCard} /><${HypothesesCard} />${state.value.simulation && html`<${AttacksCard} />`}<${MonitorsCard} query=${query} go=${go} /><${CrossingCard} /><${EventsCard} /><${TachographCard} /></div>`;
}
