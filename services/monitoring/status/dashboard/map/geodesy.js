// Geometry on the WGS84 ellipsoid for distances of a map's view: radii of curvature at the middle latitude.
const A_M = 6378137;
const E2 = 0.00669437999014;
const RAD = Math.PI / 180;

// Metres per degree of latitude and of longitude.
function scales(latitude) {
  const s = Math.sin(latitude * RAD);
  const w = Math.sqrt(1 - E2 * s * s);
  return { north: ((A_M * (1 - E2)) / w ** 3) * RAD, east: (A_M / w) * Math.cos(latitude * RAD) * RAD };
}

// The place so many metres north and east of another; places are [longitude, latitude], as in GeoJSON.
export function moved([longitude, latitude], northM, eastM) {
  const { north, east } = scales(latitude);
  return [longitude + eastM / east, latitude + northM / north];
}

// Distance [m] and initial bearing [deg from north] from one place to another.
export function between([lon1, lat1], [lon2, lat2]) {
  const { north, east } = scales((lat1 + lat2) / 2);
  const dy = (lat2 - lat1) * north;
  const dx = (lon2 - lon1) * east;
  return { metres: Math.hypot(dx, dy), degrees: (Math.atan2(dx, dy) / RAD + 360) % 360 };
}

// A closed ring: an ellipse with semi-axes along and across an azimuth [rad from north].
export function ellipse(centre, alongM, acrossM, azimuth) {
  return Array.from({ length: 65 }, (_, i) => {
    const t = (i % 64) * (Math.PI / 32);
    const u = alongM * Math.cos(t);
    const v = acrossM * Math.sin(t);
    return moved(centre, u * Math.cos(azimuth) - v * Math.sin(azimuth), u * Math.sin(azimuth) + v * Math.cos(azimuth));
  });
}

// Lines of equal latitude and longitude in a view, labelled; steps of 1, 2 or 5 with at most `lines` lines a way.
export function graticule([[west, south], [east, north]], lines = 8) {
  const features = [];
  const span = Math.max(east - west, north - south, 1e-7);
  const power = 10 ** Math.floor(Math.log10(span / lines));
  const step = [1, 2, 5, 10].map((m) => m * power).find((s) => span / s <= lines);
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  const add = (coordinates, label) => features.push({ type: "Feature", properties: { label }, geometry: { type: "LineString", coordinates } });
  for (let k = Math.ceil(west / step); k * step <= east; k += 1) {
    add([[k * step, Math.max(south, -85)], [k * step, Math.min(north, 85)]], `${(k * step).toFixed(digits)}°`);
  }
  for (let k = Math.ceil(Math.max(south, -85) / step); k * step <= Math.min(north, 85); k += 1) {
    add([[west, k * step], [east, k * step]], `${(k * step).toFixed(digits)}°`);
  }
  return { type: "FeatureCollection", features };
}
