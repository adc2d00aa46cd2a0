"""What the web server may give away: an allow list, its content types, and the policy that the browser must keep."""

import gzip
import re
import zlib
from base64 import b64encode
from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

OWN = ("html", "css", "js")  # kinds of the dashboard's own files
LIBRARIES = {
    "preact.js": "preact/dist/preact.mjs",
    "hooks.js": "preact/hooks/dist/hooks.mjs",
    "htm.js": "htm/dist/htm.module.js",
    "signals-core.js": "@preact/signals-core/dist/signals-core.mjs",
    "signals.js": "@preact/signals/dist/signals.mjs",
    "uplot.js": "uplot/dist/uPlot.iife.min.js",
}
MAP_LIBRARIES = {
    "maplibre.js": "maplibre-gl/dist/maplibre-gl.mjs",
    "maplibre-worker.js": "maplibre-gl/dist/maplibre-gl-worker.mjs",
    "maplibre.css": "maplibre-gl/dist/maplibre-gl.css",
    "pmtiles.js": "pmtiles/dist/pmtiles.js",
}  # of the page Map alone: read and compressed when first asked for
WORKERS = ("maplibre-worker.js",)  # a worker keeps the policy of its own file: it may load tiles from here
WORKER_POLICY = "default-src 'none'; script-src 'self'; connect-src 'self'"
LIBRARY_STYLE = "uplot/dist/uPlot.min.css"  # sent in front of our own style: one request less
DOCUMENTATION = {
    "swagger-ui.js": "swagger-ui-dist/swagger-ui-bundle.js",
    "swagger-ui.css": "swagger-ui-dist/swagger-ui.css",
}  # megabytes: read when asked for
TYPES = {
    "html": "text/html; charset=utf-8",
    "css": "text/css; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "mjs": "text/javascript; charset=utf-8",
}
HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
}
_INLINE = re.compile(r"<script(?![^>]*\bsrc=)[^>]*>(.*?)</script>", re.DOTALL)


@dataclass(frozen=True)
class Asset:
    """One file, compressed once."""

    content_type: str
    compressed: bytes
    etag: str

    def plain(self) -> bytes:
        """Give the file as it is, for a client that takes no gzip."""
        return gzip.decompress(self.compressed)


def own_files(folder: Path) -> dict[str, Path]:
    """Find the dashboard's own files by their path on the server; the folder of the libraries is left out."""
    folders = (folder, *(path for path in folder.iterdir() if path.is_dir() and path.name != "node_modules"))
    files = (file for inner in folders for file in inner.iterdir() if file.suffix[1:] in OWN)
    return {file.relative_to(folder).as_posix(): file for file in files}


def make_asset(name: str, content: bytes) -> Asset:
    """Prepare a file for sending."""
    kind = TYPES[name.rsplit(".", 1)[1]]
    return Asset(kind, gzip.compress(content, 9, mtime=0), f'"{sha256(content).hexdigest()[:20]}"')


def asset_of_file(path: Path) -> Asset:
    """Prepare a large file for sending, piece by piece, so that it is never in memory as a whole."""
    packer, digest, packed = zlib.compressobj(9, zlib.DEFLATED, 31), sha256(), []
    with path.open("rb") as file:
        while piece := file.read(1 << 16):
            digest.update(piece)
            packed.append(packer.compress(piece))
    return Asset(TYPES[path.suffix[1:]], b"".join([*packed, packer.flush()]), f'"{digest.hexdigest()[:20]}"')


def make_assets(files: Mapping[str, bytes]) -> dict[str, Asset]:
    """Prepare every file that was found, by its path on the server."""
    return {path: make_asset(path, content) for path, content in files.items()}


def security_policy(page: str) -> str:
    """Allow a page its own files and its own inline scripts, the import map, by their hashes, and nothing else.

    A browser takes an import map only inline; its hash keeps the policy free of 'unsafe-inline'.
    """
    hashes = " ".join(f"'sha256-{b64encode(sha256(m.encode()).digest()).decode()}'" for m in _INLINE.findall(page))
    scripts = f"'self' {hashes}".strip()
    return (
        f"default-src 'self'; script-src {scripts}; img-src 'self' data:; object-src 'none'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )


def documentation_policy(page: str) -> str:
    """Allow Swagger UI, beyond that, the style attributes that it writes."""
    return security_policy(page) + "; style-src 'self' 'unsafe-inline'"


def fingerprint(found: Mapping[str, Asset]) -> str:
    """Name this edition of the dashboard, so that a page that is older than its server reloads."""
    return sha256("".join(found[path].etag for path in sorted(found)).encode()).hexdigest()[:12]


MISSING = """<!doctype html><html lang="en"><meta charset="utf-8"><title>OBU: dashboard not set up</title>
<h1>The dashboard's libraries are not installed</h1>
<p>The unit itself is running: <a href="/api/state">/api/state</a> shows what it knows.</p>
<p>To set the dashboard up, run <code>make setup</code> in the project's folder, then start this process again.</p>
</html>"""
