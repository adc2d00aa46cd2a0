import { html } from "./parts.js";
export function GnssPage() { return html`<div class="page"></div>`; }
