import re
from base64 import b64encode
from hashlib import sha256
from pathlib import Path

from services.monitoring.status.process import DASHBOARD
from services.monitoring.status.web import assets

PAGE = '<head><script type="importmap">{"imports": {}}</script><script type="module" src="/main.js"></script></head>'


def test_an_inline_script_is_allowed_by_its_hash_and_no_other() -> None:
    digest = b64encode(sha256(b'{"imports": {}}').digest()).decode()
    policy = assets.security_policy(PAGE)
    assert f"script-src 'self' 'sha256-{digest}';" in policy
    assert "unsafe" not in policy
    assert policy.startswith("default-src 'self';")


def test_every_file_of_the_dashboard_is_on_the_allow_list() -> None:
    found = {path.name for path in DASHBOARD.iterdir() if path.suffix in (".html", ".css", ".js")}
    assert found == set(assets.PAGES)


def test_every_module_that_is_imported_is_served() -> None:
    page = (DASHBOARD / "index.html").read_text()
    mapped = set(re.findall(r'"(/lib/[^"]+)"', page))
    assert mapped <= {f"/lib/{name}" for name in (*assets.LIBRARIES, *assets.MAP_LIBRARIES)}
    names = set(re.findall(r'"([^"]+)": "/lib', page))
    for path in DASHBOARD.glob("*.js"):
        for module in re.findall(r'from "([^"]+)"|import\("([^"]+)"\)', path.read_text()):
            target = next(part for part in module if part)
            assert target in names or target.removeprefix("./") in assets.PAGES, f"{path.name} imports {target}"


def test_no_page_names_another_host() -> None:
    for name in assets.PAGES:
        text = (DASHBOARD / name).read_text().replace("http://www.w3.org/2000/svg", "")
        assert not re.findall(r"https?://(?!\$)[^\s\"']+", text), name


def test_no_library_is_part_of_the_repository() -> None:
    ignored = (Path(__file__).parents[4] / ".gitignore").read_text().splitlines()
    assert "node_modules/" in ignored


def test_the_lock_file_names_no_registry() -> None:
    assert '"resolved"' not in (DASHBOARD / "package-lock.json").read_text()


def test_a_file_is_compressed_once_and_can_be_had_plain() -> None:
    asset = assets.make_asset("main.js", b"export const answer = 42;" * 50)
    assert len(asset.compressed) < 200
    assert asset.plain() == b"export const answer = 42;" * 50
    assert asset.content_type.startswith("text/javascript")


def test_another_edition_has_another_fingerprint() -> None:
    one, two = ({"main.js": assets.make_asset("main.js", text)} for text in (b"1", b"2"))
    assert assets.fingerprint(one) != assets.fingerprint(two)
