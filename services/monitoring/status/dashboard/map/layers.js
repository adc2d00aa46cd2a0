// What can be drawn over the map: each layer names the topics that it needs and turns their newest messages into GeoJSON.
// A further layer is one more row of LAYERS: `role` chooses its colours in style.js.
import { ellipse, moved } from "./geodesy.js";

const KEPT_NS = 3e9; // a station that sends no CAM for so long is gone
const point = (coordinates, properties) => ({ type: "Feature", properties, geometry: { type: "Point", coordinates } });
export const line = (coordinates, properties) => ({ type: "Feature", properties, geometry: { type: "LineString", coordinates } });
const ring = (coordinates, properties) => ({ type: "Feature", properties, geometry: { type: "Polygon", coordinates: [coordinates] } });
const at = (p) => [p.longitude_deg, p.latitude_deg];

// A vehicle: its place, a line of two seconds of its velocity, and its label.
function vehicle(place, label, speed, heading, role) {
  const parts = [point(place, { role, label })];
  if (speed > 0.3 && heading != null) parts.push(line([place, moved(place, 2 * speed * Math.cos(heading), 2 * speed * Math.sin(heading))], { role }));
  return parts;
}

function neighbours(message) {
  return message.neighbours.flatMap((n) => {
    const [north, east] = n.velocity_ned_m_s;
    return vehicle(at(n), String(n.station_id), Math.hypot(north, east), Math.atan2(east, north), "neighbour");
  });
}

const stations = new Map(); // newest CAM of each station: the topic carries batches
function cams(message) {
  for (const cam of message.cams) if (cam.latitude_deg != null) stations.set(cam.station_id, cam);
  for (const [id, cam] of stations) if (cam.received_ns < message.received_ns - KEPT_NS) stations.delete(id);
  return [...stations.values()].flatMap((cam) => vehicle(at(cam), `${cam.station_id} ${cam.station_type.replaceAll("_", " ")}`, cam.speed_m_s, cam.heading_rad, "neighbour"));
}

const plaza = (message) => [
  point(at(message.antenna), { role: "plaza", label: message.plaza }),
  ...message.lanes.flatMap((lane) => [
    line(lane.centre.map(at), { role: "lane", label: `lane ${lane.lane}` }),
    ...["approach_line", "gate_line", "exit_line"].map((name) => line(lane[name].map(at), { role: name === "gate_line" ? "gate" : "plaza" })),
  ]),
];

const tracks = (message) => message.tracks.flatMap((t) => [
  ...vehicle(at(t), `${t.station_id}${t.lane ? `, lane ${t.lane}` : ""}`, t.speed_m_s, t.heading_rad, "neighbour"),
  ring(ellipse(at(t), t.ellipse_major_m, t.ellipse_minor_m, t.ellipse_orientation_rad), { role: "neighbour" }),
]);

export const LAYERS = [
  { id: "neighbours", topic: "v2x/neighbours", draw: neighbours },
  { id: "cams", topic: "v2x/cam", draw: cams },
  { id: "plaza", topic: "plaza/description", draw: plaza },
  { id: "tracks", topic: "toll/tracks", draw: tracks },
];

// The positions under each hypothesis: a line for each, with its name at the newest end.
export function alternatives(tracks, survives, nowNs) {
  const lines = tracks.filter((t) => t.places.length > 1).map((t) => line(t.places, { hypothesis: t.hypothesis, survives: survives(t.hypothesis) }));
  const named = tracks.filter((t) => nowNs - t.until_ns < KEPT_NS).sort((a, b) => survives(b.hypothesis) - survives(a.hypothesis)); // labels make way for earlier ones
  const ends = named.map((t) => point(t.places.at(-1), { label: t.label }));
  return collection([...lines, ...ends]);
}

// The track as runs of one colour: solid while GNSS was used, dashed in dead reckoning, dotted across a span without position.
export function trackRuns(columns, key) {
  const features = [];
  let run = null;
  let last = null;
  columns.time_ns.forEach((ns, i) => {
    const latitude = columns.fused_latitude_deg[i];
    if (latitude === null) {
      run = null;
      return;
    }
    const here = [columns.fused_longitude_deg[i], latitude];
    if (run) run.geometry.coordinates.push(here);
    else if (last) features.push(line([last, here], { kind: "gap", key: "none" }));
    const kind = columns.aided[i] ? "aided" : "dead";
    const k = key(columns, i);
    if (!run || run.properties.kind !== kind || run.properties.key !== k) {
      run = line([here], { kind, key: k });
      features.push(run);
    }
    last = here;
  });
  return { type: "FeatureCollection", features: features.filter((f) => f.geometry.coordinates.length > 1) };
}

// One source's positions as lines that break where it was silent.
export function sourceRuns(columns, source) {
  const parts = [[]];
  columns.time_ns.forEach((_, i) => {
    const latitude = columns[`${source}_latitude_deg`][i];
    if (latitude === null) parts.push([]);
    else parts.at(-1).push([columns[`${source}_longitude_deg`][i], latitude]);
  });
  return { type: "FeatureCollection", features: parts.filter((p) => p.length > 1).map((p) => line(p, { kind: source })) };
}

export const LEVELS_M = [2, 5, 10, 25]; // upper ends of the classes of the protection level
export const COLOUR_KEYS = {
  trust: (columns, i) => columns.state[i],
  level: (columns, i) => (columns.level_m[i] == null ? "none" : `level${LEVELS_M.findIndex((m) => columns.level_m[i] <= m)}`.replace("-1", LEVELS_M.length)),
};

// Sections for the table: consecutive rows of one verdict and one way of navigation.
export function sections(columns) {
  const found = [];
  columns.time_ns.forEach((ns, i) => {
    const kind = columns.fused_latitude_deg[i] === null ? "gap" : columns.aided[i] ? "aided" : "dead";
    const before = found.at(-1);
    if (before) before.to = ns;
    if (!before || before.kind !== kind || before.state !== columns.state[i]) found.push({ kind, state: columns.state[i], from: ns, to: ns, level: 0 });
    found.at(-1).level = Math.max(found.at(-1).level, columns.level_m[i] ?? 0);
  });
  return found;
}

export const roads = (network) => ({
  type: "FeatureCollection",
  features: (network?.roads ?? []).map((r) => line(r.longitude_deg.map((longitude, i) => [longitude, r.latitude_deg[i]]), { tunnel: r.tunnel, width: r.width_m })),
});

export const uncertainty = (centre, sc) => [
  ...(sc.stale ? [ring(ellipse(centre, sc.withinM, sc.withinM, 0), { role: "within" })] : []),
  ...(sc.s.protection_level_horizontal_m == null ? [] : [ring(ellipse(centre, sc.s.protection_level_horizontal_m, sc.s.protection_level_horizontal_m, 0), { role: "level" })]),
  ring(ellipse(centre, sc.s.ellipse.semi_major_m, sc.s.ellipse.semi_minor_m, sc.s.ellipse.orientation_rad), { role: "ellipse" }),
];

export const collection = (features = []) => ({ type: "FeatureCollection", features });
export const measureLine = (ends) => collection([...ends.map((p, i) => point(p, { role: "measure", label: "AB"[i] })), ...(ends.length > 1 ? [line(ends, { role: "measure" })] : [])]);
