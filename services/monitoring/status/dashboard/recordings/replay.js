// The bar of a replay: play, pause, speed, and a scrubber over the whole drive with verdicts and outages.
import { useEffect, useMemo, useRef, useState } from "preact/hooks";
import { change, clock, link, nowMs, settings, state } from "../store.js";
import { Icon, dayOf, duration, html, timeOfDay } from "../parts.js";
import { words } from "../words.js";

const w = words.replay;
const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4, 10, 20, 50, 100];
const SCRUB_MS = 100; // between two positions while the scrubber is dragged
const STEP_S = { ",": -1, ".": 1 };

async function send(command) {
  const answer = await change("api/replay", command);
  if (!answer.ok) throw new Error((await answer.json()).detail);
}

// Positions that are asked for at most ten times a second, the last one always.
function useSeek(onError) {
  const waiting = useRef({ wanted: null, timer: null });
  const next = () => {
    const box = waiting.current;
    box.timer = null;
    if (box.wanted === null) return;
    const position_s = box.wanted;
    box.wanted = null;
    box.timer = setTimeout(next, SCRUB_MS);
    send({ command: "seek", position_s }).catch(onError);
  };
  return (position_s) => {
    waiting.current.wanted = position_s;
    if (waiting.current.timer === null) next();
  };
}

// What can be jumped to: changes of the verdict after the first, and begins of outages.
function eventsOf(replay) {
  const from = replay.begin_ns;
  const changes = replay.trust.slice(1).map((c) => ({ at: (c.since_ns - from) / 1e9, text: words.trust[c.state] ?? c.state }));
  const outages = replay.outages.map((o) => ({ at: (o.since_ns - from) / 1e9, text: w.outage(o.what) }));
  return [...changes, ...outages].filter((e) => e.at >= 0).sort((a, b) => a.at - b.at);
}

function Track({ replay, length }) {
  const share = (ns) => `${(100 * Math.max(0, ns - replay.begin_ns)) / 1e9 / length}%`;
  const width = (from, to) => `${(100 * (Math.min(to, replay.end_ns) - Math.max(from, replay.begin_ns))) / 1e9 / length}%`;
  return html`<div class="replay-track" aria-hidden="true">
    ${replay.trust.map((c, i) => html`<span class="segment ${c.state}" style=${{ left: share(c.since_ns), width: width(c.since_ns, replay.trust[i + 1]?.since_ns ?? replay.end_ns) }}></span>`)}
    ${replay.outages.map((o) => html`<span class="outage" style=${{ left: share(o.since_ns), width: width(o.since_ns, o.until_ns ?? replay.end_ns) }}></span>`)}
  </div>`;
}

export function ReplayBar() {
  clock.value; // read, so that the position goes on between frames
  const replay = state.value.replay;
  const [dragged, setDragged] = useState(null);
  const [error, setError] = useState("");
  const failed = (e) => setError(e.name === "TimeoutError" || e.name === "TypeError" ? w.noAnswer : e.message);
  const run = (command) => send(command).then(() => setError(""), failed);
  const seek = useSeek(failed);
  const length = (replay.end_ns - replay.begin_ns) / 1e9;
  const position = Math.min(Math.max((nowMs() ?? replay.position_ns / 1e6) - replay.begin_ns / 1e6, 0) / 1000, length);
  const shown = dragged ?? position;
  const events = useMemo(() => eventsOf(replay), [replay.trust, replay.outages]);
  // Drawn anew with the events, and not with every position: two hours have hundreds.
  const track = useMemo(() => html`<${Track} replay=${replay} length=${length} />`, [replay.trust, replay.outages, length]);
  const following = events.find((e) => e.at > position + 1.5);
  const toggle = () => run({ command: replay.playing ? "pause" : "play" });
  const step = (s) => run({ command: "seek", position_s: Math.min(Math.max(position + s, 0), length) });
  const jump = () => following && run({ command: "seek", position_s: Math.max(following.at - 1, 0) });
  const keys = useRef(null);
  keys.current = { " ": toggle, n: jump, ",": () => step(STEP_S[","]), ".": () => step(STEP_S["."]) };
  useEffect(() => {
    let before = "";
    const pressed = (event) => {
      const busy = /^(INPUT|SELECT|TEXTAREA|BUTTON|A)$/.test(event.target.tagName) || event.ctrlKey || event.altKey || event.metaKey;
      const action = settings.value.shortcuts && !busy && before !== "g" && keys.current[event.key];
      before = event.key;
      if (!action) return;
      event.preventDefault();
      action();
    };
    addEventListener("keydown", pressed);
    return () => removeEventListener("keydown", pressed);
  }, []);
  const at = new Date(replay.begin_ns / 1e6 + shown * 1000);
  return html`<section class="replay-bar" aria-label=${w.label}>
    <button class="icon-only" onClick=${toggle} disabled=${!link.value.open} aria-label=${replay.playing ? w.pause : w.play} title=${replay.playing ? w.pause : w.play}><${Icon} name=${replay.playing ? "pause" : "play"} /></button>
    <button onClick=${() => step(-10)} disabled=${!link.value.open}>${w.back}</button>
    <button onClick=${() => step(10)} disabled=${!link.value.open}>${w.forward}</button>
    <label><span class="sr">${w.speed}</span><select value=${String(replay.speed)} onChange=${(e) => run({ command: "speed", speed: Number(e.target.value) })}>
      ${[...new Set([...SPEEDS, replay.speed])].sort((a, b) => a - b).map((s) => html`<option value=${String(s)}>${w.times(s)}</option>`)}</select></label>
    <p class="replay-time"><strong>${dayOf(at.getTime())} <time>${timeOfDay(at.getTime())}</time></strong> <span class="dim">${w.position(clockOf(shown), clockOf(length))}</span></p>
    <button onClick=${jump} disabled=${!following || !link.value.open} title=${following?.text ?? w.noEvent}>${w.next}</button>
    <p class="note" role="status">${error || (replay.lost ? w.lost : following ? w.following(following.text, clockOf(following.at)) : "")}</p>
    <div class="replay-scrubber">${track}
      <input type="range" min="0" max=${length} step="any" value=${shown} aria-label=${w.scrubber} aria-valuetext=${`${timeOfDay(at.getTime())}, ${duration(shown)}`}
        onInput=${(e) => { const value = Number(e.target.value); setDragged(value); seek(value); }}
        onKeyDown=${(e) => { const s = { ArrowLeft: -1, ArrowRight: 1, PageDown: -10, PageUp: 10 }[e.key]; if (s) { e.preventDefault(); step(s); } }}
        onChange=${() => setTimeout(() => setDragged(null), 400)} disabled=${!link.value.open} /></div>
  </section>`;
}

const clockOf = (s) => {
  const t = Math.floor(s);
  const two = (n) => String(n).padStart(2, "0");
  return t >= 3600 ? `${Math.floor(t / 3600)}:${two(Math.floor(t / 60) % 60)}:${two(t % 60)}` : `${Math.floor(t / 60)}:${two(t % 60)}`;
};
