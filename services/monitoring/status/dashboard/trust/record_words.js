// Every word of crossings and of the records of the tachograph on the page Trust.
import { zone } from "../store.js";

export const w = {
  tachograph: {
    title: "Records of the tachograph",
    get newest() { return `newest first, ${zone()}`; },
    none: "No event is recorded.",
    kind: {
      motion_conflict: "Motion conflict", distance_unauthenticated: "Distance of positions without authentication", gnss_anomaly: "GNSS anomaly",
      time_conflict: "Time conflict", position_absent: "No position for three hours of driving",
    },
    lasts: "lasts",
    length: (text) => `for ${text}`,
    similar: (count) => `, ${count} of this kind on that day`,
    purpose: { 1: "longest of the day", 2: "one of the five longest of the year", 4: "most serious of the day", 5: "one of the five most serious of the year", 7: "active" },
    note: "As Annex IC lists them; this unit reads no driver cards. obu export --format csv --topic tachograph/event writes them.",
  },
  crossing: {
    title: "Ferry or train",
    question: "Carried by a ferry or train, or spoofed? The wheels stand while GNSS moves.",
    none: "No crossing is entered: GNSS is compared with the odometer.",
    open: (since) => `Crossing entered, since ${since}: GNSS is not compared with the odometer.`,
    closed: { driver: "The last crossing was ended by the driver.", wheels: "The last crossing was closed: the wheels have turned for 100 m." },
    begin: "Begin a crossing",
    end: "End the crossing",
    sending: "Sending ...",
    refused: (reason) => `Refused: ${reason}`,
    lost: "No answer from the unit: try again",
    note: "100 m of the wheels close a crossing. Other monitors go on in it.",
  },
};
