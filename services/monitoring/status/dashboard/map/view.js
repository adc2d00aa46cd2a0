// Draws on a MapLibre map: sources, markers and the camera. It knows nothing of the page around it.
import { graticule } from "./geodesy.js";
import { collection, line, measureLine, sourceRuns, trackRuns, uncertainty } from "./layers.js";
import { makeStyle } from "./style.js";

export const STREET_ZOOM = 17;
const RECENT_ROWS = 300; // of the track are redrawn with every new row, all others seldom
const OTHERS = ["gnss", "truth"];
const NEAR_PX = 24;
const FRAME_MS = 200;
const MARKERS = {
  fused: '<path d="M0-13 9 11 0 6-9 11z" class="vehicle"/>',
  gnss: '<path d="M0-7 7 0 0 7-7 0z" class="gnss"/>',
  truth: '<path d="M0-9V9M-9 0H9" class="truth"/>',
};

const still = () => matchMedia("(prefers-reduced-motion: reduce)").matches;
const slice = (columns, from) => Object.fromEntries(Object.entries(columns).map(([name, values]) => [name, values.slice(from)]));

export class MapView {
  constructor(library, box, { theme, title, description, camera, placed, latitude, handlers }) {
    this.library = library;
    this.handlers = handlers;
    this.drawn = 0; // rows of the track that are in the source "track"
    this.markers = {};
    this.placed = placed;
    this.map = new library.Map({
      container: box, style: makeStyle(theme, description, latitude), attributionControl: false, locale: { "Map.Title": title }, maxZoom: 24, maxPitch: 0, dragRotate: true,
      pitchWithRotate: false, fadeDuration: 0, maxTileCacheSize: 0, ...camera,
    });
    this.map.addControl(new library.ScaleControl({ maxWidth: 130, unit: "metric" }));
    this.ready = new Promise((resolve) => this.map.once("load", resolve));
    this.map.on("moveend", () => this.drawGrid());
    this.map.on("dragstart", () => handlers.dragged());
    this.map.on("rotatestart", (event) => event.originalEvent && handlers.rotated());
    this.map.on("click", (event) => handlers.clicked([event.lngLat.lng, event.lngLat.lat], event.point));
    this.map.on("error", (event) => handlers.failed(event.error));
    this.ready.then(() => this.drawGrid());
  }

  remove() {
    this.map.remove();
  }

  camera() {
    return { center: this.map.getCenter().toArray(), zoom: this.map.getZoom(), bearing: this.map.getBearing() };
  }

  set(source, data) {
    this.map.getSource(source)?.setData(data);
  }

  // Beyond the view, which moves on: drawn anew only when the view has left it or its scale has changed.
  drawGrid() {
    const b = this.map.getBounds();
    const zoom = this.map.getZoom();
    if (this.grid?.zoom === zoom && this.grid.contains(b.getSouthWest()) && this.grid.contains(b.getNorthEast())) return;
    const [x, y] = [(b.getEast() - b.getWest()) / 2, (b.getNorth() - b.getSouth()) / 2];
    const around = [[b.getWest() - x, Math.max(-90, b.getSouth() - y)], [b.getEast() + x, Math.min(90, b.getNorth() + y)]];
    this.grid = Object.assign(new this.library.LngLatBounds(around), { zoom });
    this.set("graticule", graticule(around, Math.max(6, this.map.getContainer().clientWidth / 75)));
  }

  show(parts, visible) {
    for (const layer of this.map.getStyle().layers) {
      if (parts.includes(layer.metadata?.part ?? layer.source)) this.map.setLayoutProperty(layer.id, "visibility", visible ? "visible" : "none");
    }
  }

  drawTrack(columns, key, afresh) {
    const rows = columns.time_ns.length;
    if (afresh || rows - this.drawn > RECENT_ROWS) {
      this.drawn = rows;
      this.set("track", trackRuns(columns, key));
      for (const source of OTHERS) this.set(source, sourceRuns(columns, source));
    }
    const recent = slice(columns, Math.max(0, this.drawn - 1));
    this.set("recent", collection([...trackRuns(recent, key).features, ...OTHERS.flatMap((source) => sourceRuns(recent, source).features)]));
    const last = rows - 1;
    this.last = last >= 0 && columns.fused_latitude_deg[last] !== null
      ? { place: [columns.fused_longitude_deg[last], columns.fused_latitude_deg[last]], properties: { kind: columns.aided[last] ? "aided" : "dead", key: key(columns, last) } } : null;
  }

  // The present: markers, ellipse and circle, and the line from the last row to the vehicle.
  drawNow(place, sc, others) {
    this.put("fused", place, sc ? (sc.s.heading_rad * 180) / Math.PI : 0, sc?.stale);
    this.put("gnss", others.gnss, 0);
    this.put("truth", others.truth, 0);
    const tip = this.last && place && !sc.stale ? [line([this.last.place, place], this.last.properties)] : [];
    this.set("present", collection([...(sc ? uncertainty(place, sc) : []), ...tip]));
  }

  put(name, place, heading, old) {
    if (!place) {
      this.markers[name]?.remove();
      delete this.markers[name];
      return;
    }
    if (!this.markers[name]) {
      const element = document.createElement("div");
      element.className = `map-marker ${name}`;
      element.innerHTML = `<svg width="36" height="36" viewBox="-18 -18 36 36" aria-hidden="true">${MARKERS[name]}</svg>`;
      this.markers[name] = new this.library.Marker({ element, rotationAlignment: "map" }).setLngLat(place).addTo(this.map);
      element.removeAttribute("role"); // the page says in words where everything is
      element.removeAttribute("aria-label");
      element.removeAttribute("tabindex");
    }
    const marker = this.markers[name].setLngLat(place).setRotation(heading);
    marker.getElement().querySelector("path").classList.toggle("old", Boolean(old));
  }

  // Look at a place from near, unless something was looked at before.
  placeOnce(place) {
    if (this.placed || !place) return;
    this.placed = true;
    this.map.jumpTo({ center: place, zoom: STREET_ZOOM });
  }

  follow(place, bearing) {
    this.placeOnce(place);
    if (this.map.isZooming() || this.map.isRotating() || this.map.dragPan.isActive()) return;
    const to = { center: place, bearing };
    if (still()) this.map.jumpTo(to);
    else this.map.easeTo({ ...to, duration: FRAME_MS, easing: (t) => t });
  }

  zoomBy(step) {
    this.map.zoomTo(this.map.getZoom() + step, { duration: still() ? 0 : FRAME_MS });
  }

  fit(bounds) {
    this.map.fitBounds(bounds, { padding: 50, maxZoom: 19, duration: 0, bearing: 0 });
  }

  drawMeasure(ends) {
    this.set("measure", measureLine(ends));
  }

  centre() {
    return this.map.getCenter().toArray();
  }

  // Index of the row of the track that is nearest to a point of the screen, or -1.
  nearest(columns, point) {
    let best = -1;
    let least = NEAR_PX;
    columns.fused_latitude_deg.forEach((latitude, i) => {
      if (latitude === null) return;
      const p = this.map.project([columns.fused_longitude_deg[i], latitude]);
      const distance = Math.hypot(p.x - point.x, p.y - point.y);
      if (distance < least) [best, least] = [i, distance];
    });
    return best;
  }
}

export function boundsOf(columns) {
  const known = columns ? columns.fused_latitude_deg.flatMap((latitude, i) => (latitude === null ? [] : [[columns.fused_longitude_deg[i], latitude]])) : [];
  if (!known.length) return null;
  return known.reduce(([[w, s], [e, n]], [x, y]) => [[Math.min(w, x), Math.min(s, y)], [Math.max(e, x), Math.max(n, y)]], [known[0], known[0]]);
}
