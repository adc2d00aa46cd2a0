// The end of the set-up: the signed certificate, and the code by which a centre learns the unit's name.
import { useState } from "preact/hooks";
import { state } from "../store.js";
import { html } from "../parts.js";
import { Made, useMadeFile } from "../made_file.js";
import { setUpWords as w } from "./set_up_words.js";

const MOST = 200;
const usable = (text) => text.length <= MOST && /^https:\/\/[^\s/?#@]+\/?$/.test(text);

export function Certificate({ may }) {
  const [told, make] = useMadeFile(w.certificateMade);
  return html`<h3>${w.certificate}</h3><p class="note">${w.certificateWhy}</p>
    <div class="toolbar">${["pdf", "json"].map((form) => html`<button key=${form} disabled=${!may.admin || told.busy} onClick=${() => make(`api/set-up/certificate?form=${form}`, `installation.${form}`)}>${w.downloadAs(form.toUpperCase())}</button>`)}</div>
    <${Made} told=${told} />`;
}

export function Centre({ name }) {
  const [typed, setTyped] = useState("");
  const known = state.value?.uplink?.centre;
  const address = typed.trim();
  const code = usable(address) ? `api/set-up/qr.svg?centre=${encodeURIComponent(address)}` : null;
  const [broken, setBroken] = useState("");
  return html`<h3>${w.centre}</h3>${known ? html`<p>${w.enrolledAt(known)}</p>` : html`<p class="note">${w.centreWhy}</p>
    <label>${w.centreAddress} <input type="url" maxlength=${MOST} spellcheck="false" autocapitalize="off" autocomplete="off" placeholder="https://" value=${typed} onInput=${(e) => { setTyped(e.target.value); setBroken(""); }} /></label>
    <div role="status">${address && !code && html`<p class="note">${w.centreWrong}</p>`}
      ${code && (broken === code ? html`<p class="note">${w.centreName(name)}</p>` : html`<img class="qr" src=${code} alt=${w.centreCode(name)} onError=${() => setBroken(code)} /><p class="note">${w.centreCode(name)}</p>`)}</div>`}`;
}
