// Pictures of the vehicle with what is mounted in it: drawn from the settings, in the vehicle's directions.
import { html } from "../parts.js";
import { setUpWords as w } from "./set_up_words.js";

const AXES = ["x", "y", "z"];
const ASKEW = 0.9; // cosine below which an axis of the unit points along none of the vehicle
const SCALE = 42; // pixels a metre
const LEVEL = 6; // pixels a degree of the bubble
const REACH = 54;

// Forward, right, down of the vehicle on a picture: [x, y] to the right and down on the screen.
const VIEWS = { top: ([f, r]) => [r, -f], side: ([f, , d]) => [-f, d] };

const CAR_TOP = "M-38 -76q38 -22 76 0q8 70 0 152q-38 14 -76 0q-8 -82 0 -152z M-30 -38q30 -12 60 0l-5 22h-50z M-28 54q28 8 56 0l-4 -18h-48z";
const CAR_SIDE = "M-88 24q-4 -18 4 -26q10 -8 34 -10q20 -26 42 -28h42q20 2 36 28q14 2 16 12q4 12 0 24z";

const limited = (value) => Math.max(-REACH, Math.min(REACH, value));

export function directionOf([f, r, d]) {
  const values = [f, -f, r, -r, d, -d];
  const place = values.indexOf(Math.max(...values));
  return w.directions[values[place] >= ASKEW ? place : 6];
}

function Vehicle({ view, label, children }) {
  return html`<figure class="set-up-picture"><svg viewBox="-110 -100 220 200" role="img" aria-label=${label}>
    <path class="car" d=${view === "top" ? CAR_TOP : CAR_SIDE} />
    ${view === "side" && html`<circle class="car" cx="-54" cy="26" r="13" /><circle class="car" cx="54" cy="26" r="13" />`}
    ${children}</svg><figcaption>${view === "top" ? w.top : w.side}</figcaption></figure>`;
}

// `matrix`: rows of body_from_sensor; its columns are the axes of the unit in the vehicle's directions.
export function MountedUnit({ matrix }) {
  const axes = AXES.map((_, k) => matrix.map((row) => row[k]));
  const text = w.believedText(...axes.map(directionOf));
  return html`<p>${text}</p><div class="set-up-pictures">${Object.keys(VIEWS).map((view) => html`<${Vehicle} view=${view} label=${`${w.believed}. ${text}`}>
    <rect class="unit" x="-9" y="-9" width="18" height="18" rx="3" />
    ${axes.map((axis, k) => {
      const [x, y] = VIEWS[view](axis).map((part) => part * 48);
      return Math.hypot(x, y) < 8 ? html`<text class="axis" x="12" y="-12">${AXES[k]}</text>`
        : html`<line class="axis" x1="0" y1="0" x2=${x} y2=${y} /><text class="axis" x=${x * 1.25} y=${y * 1.25 + 4}>${AXES[k]}</text>`;
    })}</${Vehicle}>`)}</div>`;
}

export function Bubble({ level }) {
  const text = w.bubbleText(level.roll_deg.toFixed(1), level.pitch_deg.toFixed(1));
  return html`<figure class="set-up-picture small"><svg viewBox="-64 -64 128 128" role="img" aria-label=${`${w.bubble}: ${text}`}>
    <circle class="car" r="60" /><circle class="car" r="14" /><path class="car" d="M-60 0h120M0 -60v120" />
    <circle class="bubble" cx=${limited(-level.roll_deg * LEVEL)} cy=${limited(-level.pitch_deg * LEVEL)} r="11" /></svg>
    <figcaption>${text}</figcaption></figure>`;
}

export function Antenna({ arm }) {
  const text = arm.map((value, k) => `${w.fields[k]} ${value.toFixed(2)} m`).join(", ");
  return html`<div class="set-up-pictures">${Object.keys(VIEWS).map((view) => {
    const [x, y] = VIEWS[view](arm).map((part) => Math.max(-100, Math.min(92, part * SCALE)));
    return html`<${Vehicle} view=${view} label=${text}><rect class="unit" x="-7" y="-7" width="14" height="14" rx="3" />
      <line class="axis" x1="0" y1="0" x2=${x} y2=${y} /><circle class="bubble" cx=${x} cy=${y} r="7" /></${Vehicle}>`;
  })}</div>`;
}

// How far something is known, as a ring that fills.
export function Ring({ share, state, children }) {
  const round = 2 * Math.PI * 20;
  return html`<svg class="ring ${state}" viewBox="-24 -24 48 48" aria-hidden="true"><circle class="track" r="20" />
    <circle class="fill" r="20" transform="rotate(-90)" stroke-dasharray=${`${share * round} ${round}`} />
    <text y="4">${children}</text></svg>`;
}
