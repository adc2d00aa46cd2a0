// The close-up view from above: our own drawing, so that it works without a map, a GPU or the internet.
import { useEffect, useRef, useState } from "preact/hooks";
import { session, ageS, clock, history, isOld, isPast, remember, settings, state } from "./store.js";
import { Age, Card, Empty, Icon, compass, degrees, fixed, html, metres } from "./parts.js";
import { words } from "./words.js";

const w = words.closeup;
const HALF_M = [2, 4, 8, 15, 30, 60, 120, 250, 500, 1000, 2000, 5000];
const GRID_M = [0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000];
const GRID_PX = 36;
const TRAIL_S = 30;
const METRES_PER_DEGREE = 111320;
const REACH_M = 2000;
const SPEEDING_UP_M_S2 = 3; // a car at full throttle
const FASTEST_M_S = 50;

const world = { latitude: null, longitude: null, heading: 0, level: 0 };

function local(latitude, longitude) {
  return {
    east: (longitude - world.longitude) * METRES_PER_DEGREE * Math.cos((world.latitude * Math.PI) / 180),
    north: (latitude - world.latitude) * METRES_PER_DEGREE,
  };
}

// The drawing's origin stays on the ground, and moves only when the vehicle has left it far behind.
function place(s) {
  if (world.latitude === null) Object.assign(world, { latitude: s.latitude_deg, longitude: s.longitude_deg });
  let here = local(s.latitude_deg, s.longitude_deg);
  if (Math.hypot(here.east, here.north) > REACH_M) {
    Object.assign(world, { latitude: s.latitude_deg, longitude: s.longitude_deg });
    here = { east: 0, north: 0 };
  }
  return here;
}

function trail(nowNs) {
  let path = "";
  let pen = "M";
  history.time_ns.forEach((ns, i) => {
    const latitude = history.fields.latitude_deg?.[i];
    if (ns < nowNs - TRAIL_S * 1e9) return;
    if (latitude == null) {
      pen = "M";
      return;
    }
    const p = local(latitude, history.fields.longitude_deg[i]);
    path += `${pen}${p.east.toFixed(2)} ${(-p.north).toFixed(2)}`;
    pen = "L";
  });
  return path;
}

function gridPath(here, half, step) {
  const reach = half * 2.2 + step;
  const x0 = Math.floor((here.east - reach) / step) * step;
  const y0 = Math.floor((-here.north - reach) / step) * step;
  const n = Math.ceil((2 * reach) / step) + 1;
  let path = "";
  for (let i = 0; i <= n; i += 1) {
    path += `M${x0 + i * step} ${y0}v${n * step}M${x0} ${y0 + i * step}h${n * step}`;
  }
  return path;
}

// The smallest level that shows what must be seen; it shrinks late, so that it does not flutter.
function fit(needed) {
  while (HALF_M[world.level] < needed && world.level < HALF_M.length - 1) world.level += 1;
  while (world.level > 0 && needed < 0.7 * HALF_M[world.level - 1]) world.level -= 1;
  return world.level;
}

function useSize(ref) {
  const [size, setSize] = useState({ width: 360, height: 360 });
  useEffect(() => {
    const observer = new ResizeObserver(([entry]) => {
      const { width, height } = entry.contentRect;
      if (width && height) setSize({ width: Math.round(width), height: Math.round(height) });
    });
    observer.observe(ref.current);
    return () => observer.disconnect();
  }, []);
  return size;
}

// How far a vehicle may have gone that nobody has seen since: it may have stood, and may have set off at full throttle.
function furthest(speed, age) {
  const upTo = Math.min(age, Math.max(0, (FASTEST_M_S - speed) / SPEEDING_UP_M_S2));
  return speed * upTo + (SPEEDING_UP_M_S2 / 2) * upTo ** 2 + Math.max(speed, FASTEST_M_S) * (age - upTo);
}

// Everything that is drawn, as numbers; one function makes it for the picture, the legend and the table.
export function scene() {
  const view = state.value;
  const s = view?.solution;
  if (!s) return null;
  const stale = isPast(s);
  const age = ageS(s.updated_ns) ?? 0;
  const gnssLive = !stale && view.fix && !isOld("gnss/fix", view.fix.updated_ns) && view.fix.north_m != null;
  const truthLive = !stale && view.truth && view.truth.error_north_m != null;
  return {
    s,
    stale,
    withinM: stale ? s.ellipse.semi_major_m + furthest(s.speed_m_s + 2 * s.speed_sd_m_s, age) : null,
    gnss: gnssLive ? { north: view.fix.north_m, east: view.fix.east_m } : null,
    truth: truthLive ? { north: -view.truth.error_north_m, east: -view.truth.error_east_m } : null,
  };
}

const away = (p) => Math.hypot(p.north, p.east);

export function items(sc) {
  const { s } = sc;
  const rows = [["fused", sc.stale ? w.fusedStale : w.fused, `${s.latitude_deg.toFixed(6)}, ${s.longitude_deg.toFixed(6)}`]];
  rows.push(["ellipse", w.ellipse, `${metres(s.ellipse.semi_major_m)} × ${metres(s.ellipse.semi_minor_m)}`]);
  if (s.protection_level_horizontal_m != null) rows.push(["level", sc.stale ? w.levelOld : w.level, `${metres(s.protection_level_horizontal_m)} ${w.levelNote}`]);
  if (sc.gnss) rows.push(["gnss", w.gnss, w.apart(metres(away(sc.gnss)))]);
  if (sc.truth) rows.push(["truth", w.truth, w.apart(metres(away(sc.truth)))]);
  if (sc.stale) rows.push(["within", w.within(metres(sc.withinM)), w.withinNote]);
  return rows;
}

export const SYMBOLS = {
  fused: html`<path d="M9 2l5.5 14L9 13l-5.5 3z" class="vehicle" />`,
  ellipse: html`<ellipse cx="9" cy="9" rx="8" ry="5" class="ellipse" />`,
  level: html`<circle cx="9" cy="9" r="7.5" class="level" />`,
  gnss: html`<path d="M9 2.5 15.5 9 9 15.5 2.5 9z" class="gnss" />`,
  truth: html`<path d="M9 1.5v15M1.5 9h15" class="truth" />`,
  within: html`<circle cx="9" cy="9" r="7.5" class="within" />`,
};

function Picture({ sc, size, half, headingUp }) {
  const { s } = sc;
  const { width, height } = size;
  const scale = Math.min(width, height) / 2 / half;
  const here = place(s);
  const heading = degrees(s.heading_rad);
  // Unwrapped, so that passing north does not turn the picture all the way round.
  world.heading += ((heading - world.heading + 540) % 360) - 180;
  const turn = headingUp ? -world.heading : 0;
  const step = GRID_M.find((m) => m * scale >= GRID_PX) ?? GRID_M.at(-1);
  const at = (p) => `translate(${p.east * scale} ${-p.north * scale})`;
  const ground = `translate(${width / 2}px, ${height / 2}px) rotate(${turn}deg) scale(${scale}) translate(${-here.east}px, ${here.north}px)`;
  const label = w.label(items(sc).map(([, name, value]) => `${name}: ${value}`).join(". "));
  return html`<svg class="closeup" width=${width} height=${height} role="img" aria-label=${label}>
    <g class="ground" style=${{ transform: ground }}>
      <path d=${gridPath(here, half * (Math.max(width, height) / Math.min(width, height)), step)} class="grid" />
      <path d=${trail(state.value.now_ns)} class="trail" />
    </g>
    <g transform=${`translate(${width / 2} ${height / 2}) rotate(${turn})`}>
      ${sc.stale && html`<circle r=${Math.min(sc.withinM * scale, 4000)} class="within" />`}
      ${s.protection_level_horizontal_m != null && html`<circle r=${Math.min(s.protection_level_horizontal_m * scale, 4000)} class="level ${sc.stale ? "old" : ""}" />`}
      <ellipse rx=${s.ellipse.semi_minor_m * scale} ry=${s.ellipse.semi_major_m * scale}
        transform=${`rotate(${degrees(s.ellipse.orientation_rad)})`} class="ellipse ${sc.stale ? "old" : ""}" />
      ${sc.gnss && html`<path d="M0-7 7 0 0 7-7 0z" transform=${at(sc.gnss)} class="gnss" />`}
      ${sc.truth && html`<path d="M0-9V9M-9 0H9" transform=${at(sc.truth)} class="truth" />`}
      <path d="M0-13 9 11 0 6-9 11z" transform=${`rotate(${heading})`} class="vehicle ${sc.stale ? "old" : ""}" />
    </g>
    <g transform="translate(26 28)" class="north">
      <circle r="15" /><g transform=${`rotate(${turn})`}><path d="M0-11 4 1H-4z" /><text y="10">${w.north}</text></g>
    </g>
    <g transform=${`translate(16 ${height - 18})`} class="scale">
      <path d=${`M0-5V0H${step * scale}V-5`} /><text x=${(step * scale) / 2} y="-8">${metres(step).replace(/\.0+ /, " ").replace(/(\.\d)0 /, "$1 ")}</text>
    </g>
  </svg>`;
}

export function CloseUp() {
  clock.value;
  const box = useRef(null);
  const size = useSize(box);
  const [zoom, setZoom] = useState(null);
  const [table, setTable] = useState(false);
  const headingUp = settings.value.headingUp;
  const sc = scene();
  let level = zoom ?? world.level;
  if (sc && zoom === null) {
    const seen = [sc.gnss, sc.truth].filter(Boolean).map(away);
    level = fit(Math.max(6 * Math.min(sc.s.ellipse.semi_major_m, 1), 1.3 * sc.s.ellipse.semi_major_m, Math.min(1.15 * (sc.s.protection_level_horizontal_m ?? 0), REACH_M), 1.3 * Math.max(0, ...seen), 1.2 * sc.s.speed_m_s,
      Math.min(1.15 * (sc.withinM ?? 0), REACH_M)));
  }
  const turn = (by) => setZoom(Math.max(0, Math.min(HALF_M.length - 1, level + by)));
  const aside = sc && html`<${Age} topic="navigation/solution" stamp=${sc.s.updated_ns} />`;
  return html`<${Card} title=${w.title} id="closeup" class="closeup-card" aside=${aside}>
    <div class="stage" ref=${box}>
      ${!sc ? html`<${Empty} title=${w.empty} why=${w.emptyWhy} what=${state.value?.banner.action} />${session.value?.role === "admin" && !state.value?.replay && html`<p class="note block"><a href="#/set_up">${w.setUp}</a></p>`}`
        : table ? html`<table class="plain"><thead><tr>${w.columns.map((c) => html`<th>${c}</th>`)}</tr></thead>
            <tbody>${[...items(sc), ["heading", words.position.heading, `${fixed(compass(sc.s.heading_rad), 1)}°`]]
              .map(([, name, value]) => html`<tr><th scope="row">${name}</th><td>${value}</td></tr>`)}</tbody></table>`
        : html`<${Picture} sc=${sc} size=${size} half=${HALF_M[level]} headingUp=${headingUp} />`}
    </div>
    ${sc && html`<div class="toolbar">
      <button onClick=${() => turn(-1)} aria-label=${w.zoomIn} class="icon-only"><${Icon} name="plus" /></button>
      <button onClick=${() => turn(1)} aria-label=${w.zoomOut} class="icon-only"><${Icon} name="minus" /></button>
      <button onClick=${() => setZoom(zoom === null ? level : null)} aria-pressed=${zoom === null} title=${w.autoOn}>${w.auto}</button>
      <button onClick=${() => remember({ headingUp: !headingUp })} aria-pressed=${headingUp}>${w.headingUp}</button>
      <button onClick=${() => setTable(!table)} class="push" aria-pressed=${table}>${w.table}</button>
    </div>
    <ul class="legend">${items(sc).map(([key, name, value]) => html`<li>
      <svg width="18" height="18" aria-hidden="true">${SYMBOLS[key]}</svg><span>${name}</span><span class="dim">${key === "fused" ? "" : value}</span>
    </li>`)}</ul>`}
  </${Card}>`;
}
