// Crossings by ferry or train, and the records of the smart tachograph, on the page Trust.
import { useState } from "preact/hooks";
import { change, link, nowMs, state } from "../store.js";
import { Card, dayOf, duration, html, timeOfDay } from "../parts.js";
import { words } from "../words.js";
import { w } from "./record_words.js";

const sinceText = (ns) => {
  const age = ns == null || nowMs() === null ? null : (nowMs() - ns / 1e6) / 1000;
  return age === null ? words.age.bar : words.trustPage.at(timeOfDay(ns / 1e6), duration(Math.max(0, age)));
};

// Ferry and train: only what the driver enters here silences a rule; the wheels close what was left open.
export function CrossingCard() {
  const [text, setText] = useState("");
  const x = w.crossing;
  const crossing = state.value.crossing;
  const isOpen = Boolean(crossing?.is_open);
  const asked = Object.values(state.value.trust.monitors).some((shown) => shown.tests.carried?.reason_code?.code === "motion.carried_or_spoofed");
  const send = async () => {
    setText(x.sending);
    try {
      const answer = await change("api/command", { command: isOpen ? "crossing_end" : "crossing_begin" });
      setText(answer.ok ? "" : x.refused((await answer.json()).detail));
    } catch {
      setText(x.lost);
    }
  };
  return html`<${Card} title=${x.title} id="crossing" fold=${!asked} class="crossing-card">
    ${asked && html`<p class="lead-text"><strong>${x.question}</strong></p>`}
    <p>${isOpen ? x.open(sinceText(crossing.since_ns)) : crossing ? x.closed[crossing.ended_by] ?? x.none : x.none}</p>
    <div class="toolbar"><button onClick=${send} disabled=${!link.value.open}>${isOpen ? x.end : x.begin}</button><span class="note" role="status">${text}</span></div>
    <p class="note block">${x.note}</p>
  </${Card}>`;
}

// Records of the smart tachograph, newest first, with the purposes for which the annex keeps them.
export function TachographCard() {
  const t = w.tachograph;
  const records = [...(state.value.tachograph?.records ?? [])].reverse();
  const day = (ns) => dayOf(ns / 1e6);
  return html`<${Card} title=${t.title} note=${t.newest} id="tachograph" fold class="tachograph-card">
    ${!records.length ? html`<p class="note block">${t.none}</p>` : html`<ol class="outages events scroll" tabindex="0" aria-label=${t.title}>${records.map((r) => html`<li key=${r.kind + r.begin_utc_ns}>
      <span><strong>${t.kind[r.kind] ?? r.kind}</strong></span>
      <time>${day(r.begin_utc_ns)} ${timeOfDay(r.begin_utc_ns / 1e6)}</time>
      <span class="dim">${r.end_utc_ns == null ? t.lasts : t.length(duration((r.end_utc_ns - r.begin_utc_ns) / 1e9))}${t.similar(r.similar_that_day)}<br />${r.purposes.map((p) => t.purpose[p] ?? p).join(", ")}</span>
    </li>`)}</ol>`}
    <p class="note block">${t.note}</p>
  </${Card}>`;
}
