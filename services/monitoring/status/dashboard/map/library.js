// Loads MapLibre when the first map is shown.
let library = null;

export function loadLibrary() {
  library ??= (async () => {
    const sheet = document.createElement("link");
    Object.assign(sheet, { rel: "stylesheet", href: "lib/maplibre.css" });
    document.head.prepend(sheet);
    const found = await import("maplibre-gl");
    found.setWorkerUrl("lib/maplibre-worker.js");
    return found;
  })();
  library.catch(() => { library = null; });
  return library;
}

// The reader of PMTiles is a classic script; it registers itself as the protocol "pmtiles".
export function loadArchiveReader(found) {
  return new Promise((resolve, reject) => {
    if (window.pmtiles) return resolve();
    const script = document.createElement("script");
    script.onload = () => {
      found.addProtocol("pmtiles", new window.pmtiles.Protocol().tile);
      resolve();
    };
    script.onerror = reject;
    script.src = "lib/pmtiles.js";
    document.head.append(script);
  });
}

export function hasGraphics() {
  const context = document.createElement("canvas").getContext("webgl2");
  context?.getExtension("WEBGL_lose_context")?.loseContext();
  return context !== null;
}
