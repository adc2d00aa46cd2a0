"""The dashboard's own files, the libraries that it needs, and the page that describes the API."""

from collections.abc import Mapping
from pathlib import Path

from fastapi import APIRouter, HTTPException, Request
from fastapi.responses import FileResponse, HTMLResponse, Response

from . import assets
from .assets import Asset

DOCS = """<!doctype html><html lang="en"><head><meta charset="utf-8"><title>OBU: API</title>
<link rel="stylesheet" href="lib/swagger-ui.css"></head><body><main id="api"></main>
<script src="lib/swagger-ui.js"></script>
<script>SwaggerUIBundle({ url: "openapi.json", dom_id: "#api", deepLinking: true, validatorUrl: null,
  requestInterceptor: async (request) => {
    if (request.method === "POST") {
      const { csrf } = await (await fetch("api/session")).json();
      request.headers["X-OBU-CSRF"] = csrf ?? "none";
    }
    return request;
  } })</script>
</body></html>"""
NO_DOCS = """The page that shows this API is not installed: run `make setup` in the project's folder.
The description itself is at /openapi.json
"""


LOGIN = "access/login.html"


class Pages:
    """Serves files from memory; the few large ones of the API's description from disk."""

    def __init__(
        self, files: Mapping[str, bytes], documentation: Mapping[str, Path], later: Mapping[str, Path] | None = None
    ) -> None:
        self._assets = assets.make_assets(files)
        self._documentation, self._later = documentation, dict(later or {})
        page = files.get("index.html", b"").decode()
        self._policy = assets.security_policy(page)
        self._complete = all(name in files for name in ("index.html", *(f"lib/{n}" for n in assets.LIBRARIES)))
        self.version = assets.fingerprint(self._assets)

    def router(self) -> APIRouter:
        """Make the routes of all pages; none of them is part of the API's description."""
        router = APIRouter(include_in_schema=False)
        router.add_api_route("/", self.index)
        router.add_api_route("/login", self.login)
        router.add_api_route("/docs", self.docs)
        router.add_api_route("/lib/{name}", self.library)
        router.add_api_route("/{name:path}", self.page)
        return router

    def index(self, request: Request) -> Response:
        """Serve the dashboard, or say what to install."""
        if not self._complete:
            return HTMLResponse(assets.MISSING, 503, {"Content-Security-Policy": assets.security_policy("")})
        return _send(self._assets["index.html"], request, {"Content-Security-Policy": self._policy})

    def login(self, request: Request) -> Response:
        """Serve the page of the login."""
        if LOGIN not in self._assets:
            raise HTTPException(404, "this dashboard has no page of a login; programs send a token")
        headers = {"Content-Security-Policy": assets.security_policy(""), "Cache-Control": "no-store"}
        return _send(self._assets[LOGIN], request, headers)

    def page(self, name: str, request: Request) -> Response:
        """Serve a file of the dashboard."""
        return self._asset(name, request)

    def library(self, name: str, request: Request) -> Response:
        """Serve a library."""
        if path := self._documentation.get(name):
            return FileResponse(path, media_type=assets.TYPES[name.rsplit(".", 1)[1]])
        if name in self._later and f"lib/{name}" not in self._assets:
            self._assets[f"lib/{name}"] = assets.asset_of_file(self._later[name])
        headers = {"Content-Security-Policy": assets.WORKER_POLICY} if name in assets.WORKERS else {}
        return self._asset(f"lib/{name}", request, headers)

    def docs(self) -> Response:
        """Show the API's description."""
        if not self._documentation:
            return Response(NO_DOCS, 503, media_type="text/plain")
        policy = assets.documentation_policy(DOCS)
        return HTMLResponse(DOCS, headers={"Content-Security-Policy": policy})

    def _asset(self, path: str, request: Request, headers: Mapping[str, str] | None = None) -> Response:
        if path not in self._assets:
            raise HTTPException(404, f"there is no {path} here")
        return _send(self._assets[path], request, headers or {})


def _send(asset: Asset, request: Request, headers: Mapping[str, str]) -> Response:
    common = {"ETag": asset.etag, "Cache-Control": "no-cache", "Vary": "Accept-Encoding", **headers}
    if request.headers.get("if-none-match") == asset.etag:
        return Response(status_code=304, headers=common)
    if "gzip" in request.headers.get("accept-encoding", ""):
        return Response(asset.compressed, media_type=asset.content_type, headers={**common, "Content-Encoding": "gzip"})
    return Response(asset.plain(), media_type=asset.content_type, headers=common)


def read_pages(folder: Path) -> Pages:
    """Read what the server may give away."""
    libraries = folder / "node_modules"
    wanted = assets.own_files(folder) | {f"lib/{name}": libraries / path for name, path in assets.LIBRARIES.items()}
    large = {name: libraries / path for name, path in assets.DOCUMENTATION.items()}
    files = {name: path.read_bytes() for name, path in wanted.items() if path.is_file()}
    if "style.css" in files and (libraries / assets.LIBRARY_STYLE).is_file():
        files["style.css"] = (libraries / assets.LIBRARY_STYLE).read_bytes() + files["style.css"]
    of_map = {name: libraries / path for name, path in assets.MAP_LIBRARIES.items() if (libraries / path).is_file()}
    return Pages(files, large if all(path.is_file() for path in large.values()) else {}, of_map)
