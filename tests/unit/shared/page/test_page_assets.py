import re
from base64 import b64encode
from hashlib import sha256
from pathlib import Path

from services.monitoring.status.page import DASHBOARD
from shared.page import assets

PAGE = '<head><script type="importmap">{"imports": {}}</script><script type="module" src="/main.js"></script></head>'


def test_an_inline_script_is_allowed_by_its_hash_and_no_other() -> None:
    digest = b64encode(sha256(b'{"imports": {}}').digest()).decode()
    policy = assets.security_policy(PAGE)
    assert f"script-src 'self' 'sha256-{digest}';" in policy
    assert "unsafe" not in policy
    assert policy.startswith("default-src 'self';")


def test_only_the_dashboards_own_files_are_given_away(tmp_path: Path) -> None:
    for name in ("index.html", "package.json", ".npmrc", "map/view.js", "map/view.js.orig", "node_modules/other.js"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    assert set(assets.own_files(tmp_path)) == {"index.html", "map/view.js"}
    assert {"index.html", "style.css", "main.js", "map/map.js"} <= set(assets.own_files(DASHBOARD))


def test_every_module_that_is_imported_is_served() -> None:
    page = (DASHBOARD / "index.html").read_text()
    mapped = set(re.findall(r'"(./lib/[^"]+)"', page))
    assert mapped <= {f"./lib/{name}" for name in (*assets.LIBRARIES, *assets.MAP_LIBRARIES)}
    names = set(re.findall(r'"([^"]+)": "./lib', page))
    own = assets.own_files(DASHBOARD)
    for path in own.values():
        for module in re.findall(r'from "([^"]+)"|import\("([^"]+)"\)', path.read_text()):
            target = next(part for part in module if part)
            assert target in names or (path.parent / target).resolve() in own.values(), f"{path.name} imports {target}"


def test_no_page_names_another_host() -> None:
    for name, path in assets.own_files(DASHBOARD).items():
        text = path.read_text().replace("http://www.w3.org/2000/svg", "")
        assert not re.findall(r"https?://(?!\$)[^\s\"']+", text), name


def test_no_library_is_part_of_the_repository() -> None:
    ignored = (Path(__file__).parents[4] / ".gitignore").read_text().splitlines()
    assert "node_modules" in ignored


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
