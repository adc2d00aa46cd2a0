// A file that the unit makes for a download: it takes some seconds or more, one at a time.
import { useState } from "preact/hooks";
import { StateIcon, html, saveAs } from "./parts.js";

// `words`: making, done(name) and failed(reason).
export function useMadeFile(words) {
  const [told, setTold] = useState({ busy: false, text: "", failed: false });
  const make = async (path, fallback) => {
    setTold({ busy: true, text: words.making, failed: false });
    try {
      const answer = await fetch(path);
      if (!answer.ok) throw new Error((await answer.json()).detail ?? answer.statusText);
      const name = /filename="([^"]+)"/.exec(answer.headers.get("Content-Disposition") ?? "")?.[1] ?? fallback;
      saveAs(await answer.blob(), name);
      setTold({ busy: false, text: words.done(name), failed: false });
    } catch (problem) {
      setTold({ busy: false, text: words.failed(problem.message), failed: true });
    }
  };
  return [told, make];
}

export const Made = ({ told }) => html`<p class="note block" role="status">${told.failed && html`<${StateIcon} state="caution" word="" />`}${told.text}</p>`;
