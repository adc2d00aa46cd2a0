// Small parts that the centre's pages share.
import { useEffect, useRef, useState } from "preact/hooks";
import { StateIcon, duration, html } from "./unit/parts.js";
import { clock } from "./unit/store.js";
import { words } from "./unit/words.js";
import { OLD_S, VERDICTS, ask, centreMs, reason } from "./store.js";
import { w } from "./words.js";

export const utc = (ms) => (ms == null ? w.unknown : new Date(ms).toISOString().slice(0, 19).replace("T", " "));
export const ageS = (ms) => (ms == null ? null : Math.max(0, (centreMs() - ms) / 1000));
export const isOld = (ms) => ms == null || ageS(ms) > OLD_S;
export const wordOf = (code) => words.trust[VERDICTS[code]];

// How old a report is; it goes on growing without any message.
export function Age({ ms }) {
  clock.value;
  const age = ageS(ms);
  return html`<span class="age ${isOld(ms) ? "stale" : ""}">${age === null ? w.never : duration(age)}</span>`;
}

// A verdict in its shape, colour and word. That of an old report is not known to hold: it has the mark of what is old, and no colour.
export function Verdict({ code, ms }) {
  clock.value;
  if (code == null) return html`<span class="dim">${w.unknown}</span>`;
  const old = isOld(ms);
  return html`<span class="fleet-verdict ${old ? "faded" : ""}"><${StateIcon} state=${old ? "stale" : VERDICTS[code] ?? "stale"} word="" />${wordOf(code) ?? w.unknown}${old && html` <span class="old-mark" title=${w.map.oldTitle}>${w.map.old}</span>`}</span>`;
}

// The answer to a question, asked again each `everyMs` and when `again` is called; null asks nothing. The last one stays while there is none.
export function useAsked(path, everyMs = 0) {
  const [found, setFound] = useState({ answer: null, error: null, status: null, askedAt: 0 });
  const again = useRef(() => {});
  useEffect(() => {
    let ended = false;
    let asking = false;
    let wanted = false;
    if (path === null) {
      setFound({ answer: null, error: null, status: null, askedAt: 0 });
      again.current = () => {};
      return undefined;
    }
    const get = async () => {
      if (asking) {
        wanted = true;
        return;
      }
      asking = true;
      wanted = false;
      const askedAt = performance.now();
      try {
        const answer = await ask(path);
        if (!ended) setFound({ answer, error: null, status: 200, askedAt });
      } catch (error) {
        if (!ended) setFound((before) => ({ askedAt: before.askedAt, answer: error.status === 404 ? null : before.answer, error: reason(error), status: error.status ?? null }));
      }
      asking = false;
      if (wanted && !ended) get();
    };
    again.current = get;
    get();
    const timer = everyMs ? setInterval(get, everyMs) : null;
    return () => {
      ended = true;
      if (timer) clearInterval(timer);
    };
  }, [path, everyMs]);
  return { ...found, again: () => again.current() };
}

export const Problem = ({ text }) => html`<p class="problem" role="alert">${text ?? ""}</p>`;

export const Table = ({ label, columns, children }) => html`<div class="scroll" tabindex="0" role="group" aria-label=${label}>
  <table class="plain"><thead><tr>${columns.map((column, i) => (column ? html`<th key=${i} scope="col">${column}</th>` : html`<td key=${i}></td>`))}</tr></thead><tbody>${children}</tbody></table></div>`;
