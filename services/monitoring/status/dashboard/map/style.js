// The map's own style, light, dark and night: no sprite, no glyph file, nothing of another host; letters are drawn with local fonts.
import { LEVELS_M } from "./layers.js";

const GROUNDS = {
  light: { land: "#f1f3f0", water: "#c6ddef", green: "#dcead6", built: "#e8e6e3", building: "#d8d5d0", road: "#ffffff", casing: "#b9c1ca", rail: "#a8adb3", border: "#8f7fa8" },
  dark: { land: "#141b21", water: "#16303f", green: "#17271d", built: "#1b2127", building: "#27303a", road: "#3d4a56", casing: "#0c1115", rail: "#454d55", border: "#6d6088" },
  night: { land: "#0a0101", water: "#1c0705", green: "#120302", built: "#140403", building: "#200806", road: "#431611", casing: "#000000", rail: "#2c0b08", border: "#5a1a14" },
};
const LEVEL_COLOURS = {
  light: ["#0b5394", "#00795a", "#8a6500", "#b84f00", "#780c23"],
  dark: ["#7dbcf0", "#35c495", "#dcc24a", "#f2913d", "#ff8aa0"],
  night: ["#7a3026", "#a33c2e", "#c9503f", "#f0604d", "#ff9a88"],
};
// The alternatives: a colour of each theme and a dash pattern for each hypothesis, so that no colour has to tell them apart.
const ALTERNATIVE_COLOURS = {
  light: { nothing: "#52606d", gnss: "#b84f00", imu: "#6a3d9a", odometer: "#00795a", gnss_and_odometer: "#7a5c00", receiver_time: "#0b5394", satellites: "#a33c78" },
  dark: { nothing: "#9fb0bf", gnss: "#f2913d", imu: "#b9a0f0", odometer: "#35c495", gnss_and_odometer: "#dcc24a", receiver_time: "#7dbcf0", satellites: "#e58fc0" },
  night: { nothing: "#7a3026", gnss: "#ff9a88", imu: "#f0604d", odometer: "#d9543f", gnss_and_odometer: "#c9503f", receiver_time: "#ff7c66", satellites: "#a33c2e" },
};
const ALTERNATIVE_DASHES = { nothing: [1, 2], gnss: [5, 2], imu: [2, 1.5], odometer: [6, 2, 1, 2], gnss_and_odometer: [1, 1], receiver_time: [4, 1.5, 1, 1.5, 1, 1.5], satellites: [2, 3] };
export const alternativeStyle = (theme, hypothesis) => ({ colour: ALTERNATIVE_COLOURS[theme][hypothesis], dash: ALTERNATIVE_DASHES[hypothesis] });

const VERDICTS = ["safe", "caution", "unsafe", "above_limit", "dead_reckoning", "no_fix", "initialising", "starting", "stale", "broker_lost"];
const MARKS = { above_limit: "unsafe", dead_reckoning: "info", no_fix: "stale", initialising: "stale", starting: "stale", broker_lost: "stale" };

const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

// Colour of each key of the track: verdicts, and classes of the protection level.
export function trackColours(theme) {
  const verdicts = VERDICTS.map((v) => [v, css(`mark-${MARKS[v] ?? v}`)]);
  return Object.fromEntries([...verdicts, ...LEVEL_COLOURS[theme].map((c, i) => [`level${i}`, c]), ["none", css("mark-stale")]]);
}

// Names of layers and classes in the two common schemas of vector tiles.
const SCHEMAS = [
  {
    is: (layers) => layers.includes("transportation"), // OpenMapTiles
    roads: "transportation", key: "class", names: "transportation_name", buildings: "building", borders: ["boundary", "admin_level", 4], places: ["place", "class"],
    green: [["landcover", ["grass", "wood", "farmland"]], ["park", null]], built: [["landuse", ["residential", "commercial", "industrial", "retail"]]], streams: "waterway",
    ranks: [["motorway", "trunk"], ["primary", "secondary"], ["tertiary", "minor", "service"], ["path", "track"]], rail: ["rail", "transit"],
  },
  {
    is: (layers) => layers.includes("roads"), // Protomaps
    roads: "roads", key: "kind", names: "roads", buildings: "buildings", borders: ["boundaries", "kind_detail", 4], places: ["places", "kind"],
    green: [["landcover", ["grassland", "forest", "farmland"]], ["landuse", ["park", "forest", "wood", "grass", "nature_reserve", "farmland"]]],
    built: [["landuse", ["residential", "commercial", "industrial"]]], streams: "water",
    ranks: [["highway"], ["major_road", "medium_road"], ["minor_road", "other"], ["path"]], rail: ["rail"],
  },
];

const zoomed = (...stops) => ["interpolate", ["exponential", 1.6], ["zoom"], ...stops];
const among = (key, values) => (values ? ["in", ["get", key], ["literal", values]] : ["all"]);

function text(id, source, field, colour, halo, more = {}) {
  return {
    id, type: "symbol", source, ...more,
    layout: { "text-field": field, "text-size": 12, "text-font": ["system-ui"], ...more.layout },
    paint: { "text-color": colour, "text-halo-color": halo, "text-halo-width": 1.6 },
  };
}

function vectorLayers(description, g) {
  const s = SCHEMAS.find((schema) => schema.is(description.layers));
  if (!s) return [];
  const of = (layer, more) => ({ source: "base", "source-layer": layer, ...more });
  const fills = [...s.green.map(([layer, kinds], i) => [`green${i}`, layer, kinds, g.green]), ...s.built.map(([layer, kinds], i) => [`built${i}`, layer, kinds, g.built])];
  const widths = [[5, 1, 12, 3, 18, 26], [7, 0.6, 12, 2, 18, 20], [11, 0.4, 14, 1.5, 18, 13], [14, 0.6, 18, 4]];
  const casings = s.ranks.map((kinds, i) => of(s.roads, { id: `casing${i}`, type: "line", filter: among(s.key, kinds), layout: { "line-cap": "round", "line-join": "round" },
    paint: { "line-color": g.casing, "line-width": zoomed(...widths[i].map((v, j) => (j % 2 ? v * 1.25 + 0.8 : v))) } }));
  const roads = s.ranks.map((kinds, i) => of(s.roads, { id: `road${i}`, type: "line", filter: among(s.key, kinds), layout: { "line-cap": "round", "line-join": "round" },
    paint: { "line-color": g.road, "line-width": zoomed(...widths[i]) } }));
  return [
    ...fills.map(([id, layer, kinds, colour]) => of(layer, { id, type: "fill", filter: among(s.key, kinds), paint: { "fill-color": colour } })),
    of("water", { id: "water", type: "fill", filter: ["==", ["geometry-type"], "Polygon"], paint: { "fill-color": g.water } }),
    of(s.streams, { id: "streams", type: "line", filter: ["==", ["geometry-type"], "LineString"], paint: { "line-color": g.water, "line-width": zoomed(8, 0.5, 18, 6) } }),
    of(s.buildings, { id: "buildings", type: "fill", minzoom: 13, paint: { "fill-color": g.building } }),
    ...casings.reverse(), ...roads.reverse(),
    of(s.roads, { id: "rail", type: "line", filter: among(s.key, s.rail), paint: { "line-color": g.rail, "line-width": zoomed(9, 0.6, 18, 3), "line-dasharray": [4, 2] } }),
    of(s.borders[0], { id: "borders", type: "line", filter: ["<=", ["to-number", ["get", s.borders[1]], 99], s.borders[2]], paint: { "line-color": g.border, "line-width": 1, "line-dasharray": [3, 2] } }),
    text("road-names", "base", ["coalesce", ["get", "name"], ""], css("text"), g.land, { "source-layer": s.names, minzoom: 13, layout: { "symbol-placement": "line" } }),
    text("places", "base", ["coalesce", ["get", "name"], ""], css("text"), g.land, { "source-layer": s.places[0], filter: among(s.places[1], ["city", "town", "village", "hamlet", "suburb", "locality", "neighbourhood"]), layout: { "text-size": 14 } }),
  ];
}

export const drawable = (description) => description.tiles !== "mvt" || SCHEMAS.some((s) => s.is(description.layers));

function baseSource(description) {
  const here = new URL(".", document.baseURI).href.slice(0, -1);
  const common = description.tiles === "mvt" ? { type: "vector" } : { type: "raster", tileSize: 256 };
  const limits = { minzoom: description.zoom_minimum, maxzoom: description.zoom_maximum, bounds: description.bounds_deg };
  if (description.container === "pmtiles") return { ...common, ...limits, tiles: [`pmtiles://${here}/map/tiles.pmtiles/{z}/{x}/{y}`] };
  return { ...common, ...limits, tiles: [`${here}/map/tiles/{z}/{x}/{y}`] };
}

const EMPTY = { type: "FeatureCollection", features: [] };
// The largest zoom of the tiles of each source: what moves with the vehicle is drawn to 2 cm, all else to 8 cm, which takes fewer and smaller tiles.
const SOURCES = { graticule: 16, roads: 16, gnss: 16, truth: 16, track: 16, recent: 16, alternatives: 16, present: 18, overlay: 16, measure: 18 };
const geojson = (maxzoom) => ({ type: "geojson", data: EMPTY, maxzoom, tolerance: 0.1, buffer: 64 });

// Everything that is drawn, from the ground up; `latitude` makes roads as wide as they are.
export function makeStyle(theme, description, latitude) {
  const g = GROUNDS[theme];
  const colours = trackColours(theme);
  const colour = ["match", ["get", "key"], ...Object.entries(colours).flat(), css("mark-stale")];
  const wide = ["match", ["get", "key"], ["unsafe", `level${LEVELS_M.length}`], 7, ["caution", `level${LEVELS_M.length - 1}`], 6, 4.5];
  const metre = 512 / (40075016.7 * Math.cos((latitude * Math.PI) / 180)); // pixels at zoom 0
  const scaled = ["interpolate", ["exponential", 2], ["zoom"], 0, ["*", ["get", "width"], metre], 24, ["*", ["get", "width"], metre * 2 ** 24]];
  const round = { "line-cap": "round", "line-join": "round" };
  const casing = (source) => (
    { id: `${source}-casing`, type: "line", source, filter: ["in", ["get", "kind"], ["literal", ["aided", "dead"]]], layout: round, paint: { "line-color": css("card"), "line-width": ["+", wide, 3], "line-opacity": 0.85 } });
  const track = (source) => [
    { id: `${source}-aided`, type: "line", source, filter: ["==", ["get", "kind"], "aided"], layout: round, paint: { "line-color": colour, "line-width": wide } },
    { id: `${source}-dead`, type: "line", source, filter: ["==", ["get", "kind"], "dead"], layout: { "line-join": "round" }, paint: { "line-color": colour, "line-width": wide, "line-dasharray": [1.6, 1] } },
    { id: `${source}-gap`, type: "line", source, filter: ["==", ["get", "kind"], "gap"], paint: { "line-color": css("mark-stale"), "line-width": 2.5, "line-dasharray": [0.6, 2] } },
  ];
  const single = (kind, dash) => [kind, "recent"].map((source) => (
    { id: source === kind ? kind : `recent-${kind}`, type: "line", source, metadata: { part: kind }, filter: ["==", ["get", "kind"], kind], layout: { "line-join": "round" }, paint: { "line-color": css(kind), "line-width": 2, "line-dasharray": dash } }));
  const alternatives = Object.keys(ALTERNATIVE_DASHES).map((hypothesis) => (
    { id: `alternative-${hypothesis}`, type: "line", source: "alternatives", filter: ["==", ["get", "hypothesis"], hypothesis], layout: { "line-join": "round" },
      paint: { "line-color": ALTERNATIVE_COLOURS[theme][hypothesis], "line-width": 2.5, "line-opacity": ["case", ["get", "survives"], 0.95, 0.55], "line-dasharray": ALTERNATIVE_DASHES[hypothesis] } }));
  const inRole = (role) => ["==", ["get", "role"], role];
  const overlayColour = ["match", ["get", "role"], "neighbour", css("odometer"), "gate", css("mark-unsafe"), "lane", css("edge"), css("soft")];
  return {
    version: 8,
    sources: { ...(description ? { base: baseSource(description) } : {}), ...Object.fromEntries(Object.entries(SOURCES).map(([name, zoom]) => [name, geojson(zoom)])) },
    layers: [
      { id: "ground", type: "background", paint: { "background-color": g.land } },
      ...(description ? (description.tiles === "mvt" ? vectorLayers(description, g) : [{ id: "raster", type: "raster", source: "base", paint: { "raster-brightness-max": theme === "light" ? 1 : 0.6, "raster-saturation": theme === "light" ? 0 : -0.4 } }]) : []),
      { id: "graticule", type: "line", source: "graticule", paint: { "line-color": css("edge"), "line-width": 1, "line-opacity": 0.8 } },
      { id: "road-thin", type: "line", source: "roads", layout: round, paint: { "line-color": g.casing, "line-width": 3 } },
      { id: "road-wide", type: "line", source: "roads", layout: round, filter: ["!", ["get", "tunnel"]], paint: { "line-color": theme === "light" ? "#cfd6dd" : g.road, "line-width": scaled } },
      { id: "road-tunnel", type: "line", source: "roads", filter: ["get", "tunnel"], paint: { "line-color": theme === "light" ? "#8d98a4" : "#5a6874", "line-width": 5, "line-dasharray": [0.5, 0.5] } },
      ...single("truth", [1, 1.5]), ...single("gnss", [3, 1.5]),
      ...alternatives,
      ...["track", "recent", "present"].map(casing), ...["track", "recent", "present"].flatMap(track),
      { id: "within", type: "fill", source: "present", metadata: { part: "uncertainty" }, filter: inRole("within"), paint: { "fill-color": css("stale"), "fill-opacity": 0.2 } },
      { id: "within-edge", type: "line", source: "present", metadata: { part: "uncertainty" }, filter: inRole("within"), paint: { "line-color": css("mark-stale"), "line-width": 1.75, "line-dasharray": [4, 3] } },
      { id: "level", type: "line", source: "present", metadata: { part: "uncertainty" }, filter: inRole("level"), paint: { "line-color": css("text"), "line-width": 1.75, "line-dasharray": [1, 2] } },
      { id: "ellipse", type: "fill", source: "present", metadata: { part: "uncertainty" }, filter: inRole("ellipse"), paint: { "fill-color": css("fused"), "fill-opacity": 0.16 } },
      { id: "ellipse-edge", type: "line", source: "present", metadata: { part: "uncertainty" }, filter: inRole("ellipse"), paint: { "line-color": css("fused"), "line-width": 1.5 } },
      { id: "overlay-line", type: "line", source: "overlay", filter: ["!=", ["geometry-type"], "Point"], paint: { "line-color": overlayColour, "line-width": 2 } },
      { id: "overlay-point", type: "circle", source: "overlay", filter: ["==", ["geometry-type"], "Point"], paint: { "circle-color": overlayColour, "circle-radius": 6, "circle-stroke-width": 2, "circle-stroke-color": css("card") } },
      { id: "measure-line", type: "line", source: "measure", paint: { "line-color": css("text"), "line-width": 2.5, "line-dasharray": [3, 1.5] } },
      { id: "measure-point", type: "circle", source: "measure", filter: ["==", ["geometry-type"], "Point"], paint: { "circle-color": css("card"), "circle-radius": 6, "circle-stroke-width": 2.5, "circle-stroke-color": css("text") } },
      text("graticule-label", "graticule", ["get", "label"], css("soft"), g.land, { layout: { "symbol-placement": "line", "text-size": 11, "symbol-spacing": 350 } }),
      text("overlay-label", "overlay", ["coalesce", ["get", "label"], ""], css("text"), css("card"), { filter: ["==", ["geometry-type"], "Point"], layout: { "text-offset": [0, 1.2], "text-anchor": "top" } }),
      text("alternative-label", "alternatives", ["get", "label"], css("text"), css("card"), { filter: ["==", ["geometry-type"], "Point"], layout: { "text-offset": [0.7, 0], "text-anchor": "left", "text-optional": true } }),
      text("measure-label", "measure", ["coalesce", ["get", "label"], ""], css("text"), css("card"), { filter: ["==", ["geometry-type"], "Point"], layout: { "text-offset": [0, -1.3] } }),
    ],
  };
}
