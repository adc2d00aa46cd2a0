// Times as the viewer reads them: UTC, or the time of the browser's place.
import { settings } from "./store.js";

const isLocal = () => settings.value.clock === "local";

// The same moment, whose UTC fields are those of the chosen clock.
function shown(ms) {
  const date = new Date(ms);
  return isLocal() ? new Date(ms - date.getTimezoneOffset() * 60000) : date;
}

export const timeOfDay = (ms, tenths = false) => shown(ms).toISOString().slice(11, tenths ? 21 : 19);
export const dayOf = (ms) => shown(ms).toISOString().slice(0, 10);

// Name of the clock at a moment: daylight saving time has another.
export function zone(ms = Date.now()) {
  if (!isLocal()) return "UTC";
  const minutes = -new Date(ms).getTimezoneOffset();
  const [hours, rest] = [Math.floor(Math.abs(minutes) / 60), Math.abs(minutes) % 60];
  return minutes === 0 ? "UTC" : `UTC${minutes < 0 ? "\u2212" : "+"}${hours}${rest ? `:${String(rest).padStart(2, "0")}` : ""}`;
}
