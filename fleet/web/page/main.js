// The shell around the centre's pages: who is logged in, the connection, navigation.
import { render } from "preact";
import { useEffect, useRef, useState } from "preact/hooks";
import { clock, logOut, remember, renew, session, settings, tellErrors } from "./unit/store.js";
import { Empty, Guard, Icon, duration, html } from "./unit/parts.js";
import { link, may, start } from "./store.js";
import { MapPage } from "./map.js";
import { VehiclePage } from "./vehicle.js";
import { AlarmsPage } from "./alarms.js";
import { AccountPage, AccountsPage, AuditPage, EnrolmentPage, PassagesPage } from "./admin.js";
import { w } from "./words.js";

const THEMES = ["auto", "light", "dark", "night"];
const LOST_AFTER_S = 2;
// Pages with their icon, the right that they need, and whether the navigation lists them.
const PAGES = {
  map: [MapPage, "map", "see", true],
  alarms: [AlarmsPage, "caution", "see", true],
  passages: [PassagesPage, "toll", "passages", true],
  enrolment: [EnrolmentPage, "plus", "admin", true],
  accounts: [AccountsPage, "trust", "admin", true],
  audit: [AuditPage, "recordings", "admin", true],
  vehicles: [VehiclePage, "now", "see", false],
  account: [AccountPage, "trust", "signed in", false],
};

const first = () => Object.keys(PAGES).find((name) => may(PAGES[name][2]));

// An address that somebody has mistyped names no vehicle; the page says so.
function decoded(text) {
  try {
    return decodeURIComponent(text);
  } catch {
    return text;
  }
}

function useRoute() {
  const [hash, setHash] = useState(location.hash);
  useEffect(() => {
    const changed = () => setHash(location.hash);
    addEventListener("hashchange", changed);
    return () => removeEventListener("hashchange", changed);
  }, []);
  const [page, ...rest] = hash.replace(/^#\/?/, "").split("/");
  return PAGES[page] ? { page, name: decoded(rest.join("/")) } : { page: first(), name: "" };
}

function Header() {
  const { name, role, tenant } = session.value;
  const next = THEMES[(THEMES.indexOf(settings.value.theme) + 1) % THEMES.length];
  return html`<header class="top">
    <p class="who"><span class="dim">${w.centre}</span> ${tenant}</p>
    <p class="push account"><a href="#/account" title=${w.pages.account}>${name}</a> <span class="dim" title=${w.roles[role]}>${role}</span></p>
    <div class="tools">
      <button class="ghost icon-only" onClick=${logOut} aria-label=${w.logOut(name)} title=${w.logOut(name)}><${Icon} name="logOut" /></button>
      <button class="ghost icon-only" onClick=${() => remember({ theme: next })} aria-label=${w.theme(w.themes[settings.value.theme])} title=${w.themes[settings.value.theme]}><${Icon} name="sun" /></button>
    </div>
  </header>`;
}

function LostBar() {
  clock.value;
  const { open, bus, lostAt } = link.value;
  const lostS = lostAt === null ? 0 : (performance.now() - lostAt) / 1000;
  const lost = !open && lostS > LOST_AFTER_S;
  return html`<section class="notices" aria-label=${w.centre}><div role="status">
    ${lost && html`<div class="bar lost"><${Icon} name="stale" /><p>${w.lost(duration(lostS))}</p></div>`}
    ${open && !bus && html`<div class="bar lost"><${Icon} name="stale" /><p>${w.noBus}</p></div>`}
  </div></section>`;
}

function Navigation({ page }) {
  const listed = Object.entries(PAGES).filter(([, [, , right, shown]]) => shown && may(right));
  return html`<nav class="pages" aria-label=${w.navigation}><ul>
    ${listed.map(([name, [, icon]]) => html`<li key=${name}><a href=${`#/${name}`} aria-current=${page === name ? "page" : null}><${Icon} name=${icon} />${w.pages[name]}</a></li>`)}
  </ul></nav>`;
}

function App() {
  const { page, name } = useRoute();
  const heading = useRef(null);
  useEffect(() => {
    document.documentElement.dataset.theme = settings.value.theme;
  }, [settings.value.theme]);
  const [Page, , right] = PAGES[page];
  const title = page === "vehicles" ? w.vehicle.title(name) : w.pages[page];
  useEffect(() => {
    document.title = `${title} - ${session.value.tenant} - ${w.centre}`;
  }, [title]);
  return html`<a class="skip" href="#content" onClick=${(e) => { e.preventDefault(); heading.current.focus(); }}>${w.skip}</a>
    <${Guard}><${Header} /><${LostBar} /></${Guard}>
    <div class="body"><${Guard}><${Navigation} page=${page} /></${Guard}>
      <main id="content"><h1 class="sr" ref=${heading} tabindex="-1">${title}</h1>
        <${Guard} key=${`${page} ${name}`}>${may(right) ? html`<${Page} key=${name} name=${name} />` : html`<${Empty} title=${w.forbidden} why=${w.forbiddenWhy(session.value.role)} />`}</${Guard}>
      </main></div>`;
}

async function begin() {
  tellErrors();
  const root = document.getElementById("app");
  const who = await renew().catch(() => null);
  if (!who) {
    root.replaceChildren();
    render(html`<${Empty} title=${w.noAnswer} what=${html`<button onClick=${() => location.reload()}>${w.retry}</button>`} />`, root);
    return;
  }
  if (!who.role) return location.replace(`login${location.hash}`);
  start();
  root.replaceChildren();
  render(html`<${Guard}><${App} /></${Guard}>`, root);
}
begin();
