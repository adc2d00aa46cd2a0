// Draws the fleet on a MapLibre map: clusters and vehicles from tiles, changes since then above them, one track.
import { render } from "preact";
import { Icon, html } from "./unit/parts.js";
import { words } from "./unit/words.js";
import { MapView } from "./unit/map/view.js";
import { trackColours } from "./unit/map/style.js";
import { COLOUR_KEYS, collection } from "./unit/map/layers.js";
import { OLD_S, VERDICTS, centreMs } from "./store.js";

const ICON_PX = 24;
const REFRESH_MS = 3000; // tiles are at most two seconds old at the centre
const KEPT_MS = 6000; // a change is in the tiles by then
const NEAR_PX = 10;
const LAYERS = ["cluster", "vehicle", "changed-vehicle"];
const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

// The icon of a verdict as on every page, as an image of the map.
async function imageOf(name, colour, cut) {
  const box = document.createElement("div");
  render(html`<${Icon} name=${name} />`, box);
  const shape = box.querySelector("svg").innerHTML;
  render(null, box);
  const line = "fill:none;stroke-width:2;stroke-linecap:round;stroke-linejoin:round;stroke:";
  const svg = `<svg xmlns="http://www.w3.org/2000/svg" width="${2 * ICON_PX}" height="${2 * ICON_PX}" viewBox="-1.5 -1.5 27 27" color="${colour}"><style>.line{${line}${colour}}.cut{${line}${cut};stroke-width:2.4}</style><circle cx="12" cy="12" r="13" fill="${cut}"/>${shape}</svg>`;
  const image = new Image(2 * ICON_PX, 2 * ICON_PX);
  image.src = `data:image/svg+xml,${encodeURIComponent(svg)}`;
  await image.decode();
  return image;
}

async function arrow(colour) {
  const svg = `<svg xmlns="http://www.w3.org/2000/svg" width="${4 * ICON_PX}" height="${4 * ICON_PX}" viewBox="-24 -24 48 48"><path d="M0-23 6-14H-6z" fill="${colour}"/></svg>`;
  const image = new Image(4 * ICON_PX, 4 * ICON_PX);
  image.src = `data:image/svg+xml,${encodeURIComponent(svg)}`;
  await image.decode();
  return image;
}

const label = ["case", [">", ["get", "age_s"], OLD_S],
  ["concat", ["get", "name"], "\n", ["case", [">=", ["get", "age_s"], 3600], ["concat", ["to-string", ["floor", ["/", ["get", "age_s"], 3600]]], " h old"], ["concat", ["to-string", ["floor", ["/", ["get", "age_s"], 60]]], " min old"]]],
  ["get", "name"]];

function vehicleLayers(source, id, more, only) {
  const single = only ?? ["==", ["get", "vehicles"], 1];
  const faded = ["case", [">", ["get", "age_s"], OLD_S], 0.5, 1];
  const image = ["case", [">", ["get", "age_s"], OLD_S], "verdict-old", ["concat", "verdict-", ["to-string", ["get", "verdict"]]]];
  const always = { "icon-allow-overlap": true, "icon-ignore-placement": true };
  return [
    { id: `${id}-course`, type: "symbol", source, ...more, filter: ["all", single, ["has", "course_deg"]],
      layout: { ...always, "icon-image": "arrow", "icon-rotate": ["get", "course_deg"], "icon-rotation-alignment": "map", "icon-size": 0.9 }, paint: { "icon-opacity": faded } },
    { id, type: "symbol", source, ...more, filter: single,
      layout: { ...always, "icon-image": image, "icon-size": 0.8, "symbol-sort-key": ["get", "verdict"], "text-field": label, "text-font": ["system-ui"], "text-size": 11.5, "text-anchor": "top", "text-offset": [0, 1.15], "text-optional": true },
      paint: { "icon-opacity": faded, "text-color": css("text"), "text-halo-color": css("card"), "text-halo-width": 1.6 } },
  ];
}

function clusterLayers(theme) {
  const colours = trackColours(theme);
  const allOld = ["==", ["get", "old"], ["get", "vehicles"]];
  const colour = ["case", allOld, css("mark-stale"), ["match", ["get", "verdict"], ...VERDICTS.flatMap((name, code) => [code, colours[name]]), css("mark-stale")]];
  const radius = ["interpolate", ["linear"], ["log10", ["get", "vehicles"]], 0.3, 15, 3.5, 27];
  const more = { source: "vehicles", "source-layer": "vehicles", filter: [">", ["get", "vehicles"], 1] };
  const faded = ["case", allOld, 0.5, 1];
  return [
    { id: "cluster", type: "circle", ...more, layout: { "circle-sort-key": ["get", "verdict"] },
      paint: { "circle-color": css("card"), "circle-radius": radius, "circle-stroke-color": colour, "circle-stroke-width": ["case", [">=", ["get", "verdict"], 5], 5, 3], "circle-stroke-opacity": faded, "circle-opacity": 0.94 } },
    { id: "cluster-text", type: "symbol", ...more,
      layout: { "icon-image": ["case", allOld, "verdict-old", ["concat", "verdict-", ["to-string", ["get", "verdict"]]]], "icon-size": 0.55, "icon-offset": [0, -13], "icon-allow-overlap": true, "icon-ignore-placement": true, "text-field": ["to-string", ["get", "vehicles"]], "text-font": ["system-ui"], "text-size": 12.5, "text-offset": [0, 0.35], "text-allow-overlap": true, "text-ignore-placement": true },
      paint: { "text-color": css("text"), "icon-opacity": faded } },
  ];
}

export class FleetView extends MapView {
  constructor(library, box, options) {
    super(library, box, options);
    this.query = options.query;
    this.theme = options.theme;
    this.changed = new Map();
    this.ready = this.ready.then(() => this.addVehicles());
  }

  async addVehicles() {
    const colours = trackColours(this.theme);
    const images = await Promise.all(VERDICTS.map((name) => imageOf(name, colours[name], css("card"))));
    const old = await imageOf("stale", css("mark-stale"), css("card"));
    const pointer = await arrow(css("text"));
    if (this.removed) return;
    images.forEach((image, code) => this.map.addImage(`verdict-${code}`, image, { pixelRatio: 2 }));
    this.map.addImage("verdict-old", old, { pixelRatio: 2 });
    this.map.addImage("arrow", pointer, { pixelRatio: 2 });
    this.map.addSource("vehicles", { type: "vector", tiles: [this.address()], maxzoom: 18 });
    this.map.addSource("changed", { type: "geojson", data: collection() });
    this.map.addSource("chosen", { type: "geojson", data: collection() });
    const layers = [
      { id: "chosen", type: "circle", source: "chosen", paint: { "circle-radius": 17, "circle-color": css("fused"), "circle-opacity": 0.25, "circle-stroke-width": 2.5, "circle-stroke-color": css("fused") } },
      ...clusterLayers(this.theme),
      ...vehicleLayers("vehicles", "vehicle", { "source-layer": "vehicles" }),
      ...vehicleLayers("changed", "changed-vehicle", {}, ["has", "name"]),
    ];
    for (const layer of layers) this.map.addLayer(layer);
    this.timer = setInterval(() => this.refresh(), REFRESH_MS);
  }

  remove() {
    this.removed = true;
    clearInterval(this.timer);
    super.remove();
  }

  address() {
    return `${new URL("tiles/", document.baseURI).href}{z}/{x}/{y}.mvt${this.query}`;
  }

  filter(query) {
    if (query === this.query) return;
    this.query = query;
    this.changed.clear();
    this.drawChanged();
    this.map.getSource("vehicles")?.setTiles([this.address()]);
  }

  refresh() {
    if (document.hidden || !this.map.getSource("vehicles")) return;
    this.map.refreshTiles("vehicles");
    const now = performance.now();
    const before = this.changed.size;
    for (const [name, entry] of this.changed) if (now - entry.at > KEPT_MS) this.changed.delete(name);
    if (before) this.drawChanged();
  }

  // Vehicles whose verdict has changed stand above their tile until it is made anew.
  change(rows) {
    for (const row of rows) {
      if (row.latitude_deg == null) continue;
      const moving = Math.hypot(row.north_m_s ?? 0, row.east_m_s ?? 0) > 0.5;
      const properties = { name: row.vehicle, verdict: row.verdict, age_s: Math.max(0, (centreMs() - row.utc_ms) / 1000) };
      if (moving) properties.course_deg = (Math.atan2(row.east_m_s, row.north_m_s) * 180) / Math.PI;
      this.changed.set(row.vehicle, { at: performance.now(), feature: { type: "Feature", properties, geometry: { type: "Point", coordinates: [row.longitude_deg, row.latitude_deg] } } });
    }
    this.drawChanged();
  }

  drawChanged() {
    this.set("changed", collection([...this.changed.values()].map((entry) => entry.feature)));
    const hidden = ["literal", [...this.changed.keys()]];
    for (const [id, more] of [["vehicle", true], ["vehicle-course", ["has", "course_deg"]]]) {
      if (this.map.getLayer(id)) this.map.setFilter(id, ["all", ["==", ["get", "vehicles"], 1], more, ["!", ["in", ["get", "name"], hidden]]]);
    }
  }

  // What is under a point: {vehicle} or {cluster: place}, or null.
  under({ x, y }) {
    const box = [[x - NEAR_PX, y - NEAR_PX], [x + NEAR_PX, y + NEAR_PX]];
    const layers = LAYERS.filter((id) => this.map.getLayer(id));
    const found = this.map.queryRenderedFeatures(box, { layers })[0];
    if (!found) return null;
    return found.properties.name ? { vehicle: found.properties.name } : { cluster: found.geometry.coordinates };
  }

  look(place, zoom) {
    const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    const to = { center: place, zoom: Math.max(zoom, this.map.getZoom()) };
    if (still) this.map.jumpTo(to);
    else this.map.easeTo({ ...to, duration: 400 });
  }

  choose(row, trail) {
    const place = row?.longitude_deg == null ? null : [row.longitude_deg, row.latitude_deg];
    this.set("chosen", collection(place ? [{ type: "Feature", properties: {}, geometry: { type: "Point", coordinates: place } }] : []));
    this.drawTrack(columnsOf(trail), COLOUR_KEYS.trust, true);
  }
}

// A track as the unit's map draws it.
export function columnsOf(trail) {
  const nothing = trail ? trail.time_ms.map(() => null) : [];
  return {
    time_ns: (trail?.time_ms ?? []).map((ms) => ms * 1e6),
    state: (trail?.verdict ?? []).map((code) => VERDICTS[code]),
    aided: (trail?.verdict ?? []).map((code) => (VERDICTS[code] === "dead_reckoning" ? 0 : 1)),
    fused_latitude_deg: trail?.latitude_deg ?? [],
    fused_longitude_deg: trail?.longitude_deg ?? [],
    gnss_latitude_deg: nothing, gnss_longitude_deg: nothing, truth_latitude_deg: nothing, truth_longitude_deg: nothing,
    level_m: nothing,
  };
}

export const verdictWord = (code) => words.trust[VERDICTS[code]];
