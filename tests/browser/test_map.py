"""The page Map: the track on tiles, on the roads of the simulation and on the bare grid; its tools and downloads."""

import io
import json
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from math import dist, radians
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Page, ViewportSize, expect

from services.monitoring.status.process import TRACK_FILE
from services.sensors.simulator.motion.centre_line import road_network
from services.sensors.simulator.motion.roads import Course, RoadSegment, bend
from services.sensors.simulator.scenarios import scenario_of
from services.sensors.simulator.v2x.radio import Radio
from services.sensors.simulator.vehicle import AntennaState
from shared.maths.earth import Geodetic, ecef_from_geodetic
from tests.browser.test_pages import faults, judge_everywhere, keep_picture
from tests.support.dashboard.fake_unit import LATITUDE_DEG, LONGITUDE_DEG
from tests.support.dashboard.status_server import RunningServer, eventually, status_server
from tests.support.dashboard.tile_files import write_mbtiles, write_pmtiles
from tests.support.v2x.tolling import PLAZA

SIZES: dict[str, ViewportSize] = {
    "wide": {"width": 1360, "height": 850},
    "small": {"width": 760, "height": 600},  # where size does not matter: WebGL is computed in software here
    "phone": {"width": 390, "height": 844},
}
MINUTE_NS = 60 * 10**9
MAP_PAGE_BYTES = 550_000
SAFE, WATER, ROAD = (0x00, 0x78, 0x4A), (0xC6, 0xDD, 0xEF), (0xCF, 0xD6, 0xDD)  # of the light style
ROUND = Course((RoadSegment(100.0, (5.0, 6.0)), bend(360.0, 60.0, (5.0, 6.0), (1.0, 2.0))))


@pytest.fixture(scope="module")
def tiled(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningServer]:
    """A unit that has driven a while, with a PMTiles file."""
    folder = tmp_path_factory.mktemp("tiled")
    write_pmtiles(folder / "a.pmtiles", LATITUDE_DEG, LONGITUDE_DEG, protomaps=True)
    with status_server(folder, map_file=str(folder / "a.pmtiles")) as server:
        eventually(lambda: len(rows(server)) > 10)
        yield server


def rows(server: RunningServer) -> list[int]:
    answer = httpx.get(f"{server.address}/api/track").raise_for_status().json()
    return list(answer["columns"]["time_ns"])


def share(page: Page, colour: tuple[int, int, int]) -> float:
    """Part of the map's picture that has a colour."""
    picture = Image.open(io.BytesIO(page.locator(".map-stage").screenshot())).convert("RGB")
    near = np.abs(np.asarray(picture, dtype=int) - colour).max(axis=2) < 6
    return float(near.mean())


def drawn(page: Page, colour: tuple[int, int, int], at_least: float) -> None:
    eventually(lambda: share(page, colour) > at_least)


def test_the_map_page_is_accessible_asks_nobody_else_and_keeps_to_its_budget(
    tiled: RunningServer, open_page: Callable[..., Page]
) -> None:
    page = open_page("about:blank", reduced_motion="reduce", viewport=SIZES["wide"])
    asked: list[str] = []
    page.context.on("request", lambda request: asked.append(request.url))
    page.goto(f"{tiled.address}/#/map")
    drawn(page, SAFE, 0.0005)
    drawn(page, WATER, 0.2)
    expect(page.get_by_text("© test mappers")).to_be_visible()
    expect(page.locator(".map-wait")).to_have_count(0)
    judge_everywhere(page, "map")
    assert {urlsplit(url).netloc for url in asked if not url.startswith("data:")} == {urlsplit(tiled.address).netloc}
    code = {url for url in asked if not re.search(r"/api/|/map/tiles|^data:", url)} | {
        f"{tiled.address}/lib/maplibre-worker.js"
    }
    packed = sum(int(httpx.get(url, headers={"Accept-Encoding": "gzip"}).headers["content-length"]) for url in code)
    assert packed <= MAP_PAGE_BYTES


@pytest.mark.slow
def test_layers_follow_measure_table_and_inspection_do_what_they_say(
    tiled: RunningServer, open_page: Callable[..., Page]
) -> None:
    page = open_page(tiled.address, path="map", reduced_motion="reduce", viewport=SIZES["small"])
    drawn(page, WATER, 0.2)
    page.locator("summary", has_text="Layers").click()
    page.get_by_role("checkbox", name="Map", exact=True).uncheck()
    eventually(lambda: share(page, WATER) < 0.01)
    page.get_by_role("checkbox", name="Map", exact=True).check()
    page.locator("summary", has_text="Layers").click()
    message = page.locator(".map-message")
    box = page.locator(".map-stage").bounding_box()
    assert box
    follow = page.get_by_role("button", name="Follow")
    expect(follow).to_have_attribute("aria-pressed", "true")
    page.mouse.move(box["x"] + 300, box["y"] + 100)
    page.mouse.down()
    page.mouse.move(box["x"] + 360, box["y"] + 140, steps=4)
    page.mouse.up()
    expect(follow).to_have_attribute("aria-pressed", "false")
    page.get_by_role("button", name="Measure").click()
    page.mouse.click(box["x"] + 100, box["y"] + 100)
    expect(message).to_have_text("Choose the second point.")
    page.mouse.click(box["x"] + 400, box["y"] + 100)
    expect(message).to_have_text(re.compile(r"From A to B: [\d.]+ m, bearing 090\.0°\."))
    page.get_by_role("button", name="Measure").click()
    page.get_by_role("button", name="Whole track").click()
    keep_picture(page, "map-whole")
    page.get_by_label("Track colour").select_option("level")
    expect(page.locator(".map-legend")).to_contain_text("2 to 5 m")
    page.get_by_role("button", name="Table").click()
    table = page.get_by_role("group", name="Table")
    expect(table.locator("tbody tr").first).to_contain_text("3.1 m")
    expect(table).to_contain_text("GNSS used")
    assert faults(page) == []


def test_distances_agree_with_chords_of_the_ellipsoid(tiled: RunningServer, open_page: Callable[..., Page]) -> None:
    page = open_page(tiled.address)
    expect(page.locator("svg.closeup")).to_be_visible()
    for a, b in (([11.0, 48.0], [11.03, 48.02]), ([-70.0, -33.0], [-70.0, -33.05]), ([25.0, 68.0], [25.1, 68.0])):
        found = page.evaluate("async ([a, b]) => (await import('/map/geodesy.js')).between(a, b)", [a, b])
        ends = [ecef_from_geodetic(Geodetic(radians(lat), radians(lon), 0.0)) for lon, lat in (a, b)]
        assert found["metres"] == pytest.approx(dist(*ends), rel=2e-6)
        back = page.evaluate("async ([a, b]) => (await import('/map/geodesy.js')).between(b, a)", [a, b])
        assert (found["degrees"] - back["degrees"]) % 360 == pytest.approx(180.0)


def test_each_layer_draws_the_messages_of_its_topic(tiled: RunningServer, open_page: Callable[..., Page]) -> None:
    page = open_page(tiled.address)
    expect(page.locator("svg.closeup")).to_be_visible()
    scenario = scenario_of("urban")
    neighbours = Radio(scenario, 1, 4).receive(
        30.0, 7, scenario.start, AntennaState(scenario.start, (0.0, 0.0, 0.0), covered=False, heading=0.0)
    )
    plaza = PLAZA.description(7)
    draw = "async ([topic, m]) => (await import('/map/layers.js')).LAYERS.find((l) => l.topic === topic).draw(m)"
    for topic, message, points in (("v2x/neighbours", neighbours, 4), ("plaza/description", plaza, 1)):
        features = page.evaluate(draw, [topic, message.model_dump(mode="json")])
        assert len([f for f in features if f["geometry"]["type"] == "Point"]) == points
        assert all(f["properties"]["role"] for f in features)


def test_the_track_can_be_downloaded_and_is_sent_in_parts(tiled: RunningServer) -> None:
    for name, root in (("gpx", "gpx"), ("kml", "kml")):
        answer = httpx.get(f"{tiled.address}/api/track.{name}").raise_for_status()
        assert answer.headers["content-disposition"] == f'attachment; filename="truck-07-fused.{name}"'
        assert ET.fromstring(answer.text).tag.endswith(f"}}{root}")
    whole = httpx.get(f"{tiled.address}/api/track").json()
    middle = whole["columns"]["time_ns"][3]
    part = httpx.get(f"{tiled.address}/api/track?after_ns={middle}&generation={whole['generation']}").json()
    assert whole["complete"] and not part["complete"]
    assert part["columns"]["time_ns"][:4] == whole["columns"]["time_ns"][4:8]
    assert httpx.get(f"{tiled.address}/api/track?generation=99&after_ns={middle}").json()["complete"]
    assert httpx.get(f"{tiled.address}/api/track.gpx?source=elsewhere").status_code == 422
    archive = httpx.get(f"{tiled.address}/map/tiles.pmtiles", headers={"Range": "bytes=0-6"})
    assert (archive.status_code, archive.content) == (206, b"PMTiles")
    assert httpx.get(f"{tiled.address}/map/tiles/1/0/0").status_code == 404


def test_the_track_survives_a_restart_of_the_process(tmp_path: Path) -> None:
    with status_server(tmp_path) as server:
        eventually(lambda: len(rows(server)) > 5)
    kept = [json.loads(line) for line in (tmp_path / TRACK_FILE).read_text().splitlines()]
    for row in kept:
        row["time_ns"] -= MINUTE_NS  # the clock of the pretended unit begins anew with it
    (tmp_path / TRACK_FILE).write_text("\n".join(map(json.dumps, kept)))
    before = [row["time_ns"] for row in kept]
    with status_server(tmp_path) as server:
        assert rows(server)[: len(before)] == before
        eventually(lambda: len(rows(server)) > len(before) + 5)


def test_roads_of_the_simulation_and_tiles_of_an_mbtiles_file_are_drawn(
    tmp_path: Path, open_page: Callable[..., Page]
) -> None:
    write_mbtiles(tmp_path / "a.mbtiles", LATITUDE_DEG, LONGITUDE_DEG)
    with status_server(tmp_path, map_file=str(tmp_path / "a.mbtiles")) as server:
        start = Geodetic(radians(LATITUDE_DEG), radians(LONGITUDE_DEG) - 1e-5, 500.0)
        server.bus.feed(road_network(ROUND, start, server.bus.now_ns()), "sensors.simulator")
        page = open_page(server.address, path="map", reduced_motion="reduce", viewport=SIZES["small"])
        drawn(page, WATER, 0.2)
        drawn(page, ROAD, 0.005)
        keep_picture(page, "map-roads")
        assert server.unit
        server.unit.silent.add("core.fusion")
        expect(page.locator(".map-marker .vehicle.old")).to_be_attached()
        expect(page.locator(".map-legend")).to_contain_text("could be up to")
        page.wait_for_timeout(300)
        keep_picture(page, "map-stale")


def test_without_a_map_a_position_or_webgl_the_page_says_so(tmp_path: Path, open_page: Callable[..., Page]) -> None:
    with status_server(tmp_path, unit=False, map_file=str(tmp_path / "lost.pmtiles")) as server:
        page = open_page(server.address, path="map", reduced_motion="reduce", viewport=SIZES["phone"])
        expect(page.get_by_text("No position yet")).to_be_visible()
        expect(page.get_by_text("the map lost.pmtiles named by map_file is not there")).to_be_visible()
        expect(page.get_by_text("No map is installed: the grid shows latitude and longitude")).to_be_visible()
        expect(page.locator(".map-wait")).to_have_count(0)
        keep_picture(page, "map-empty")
        assert faults(page) == []
        page = open_page("about:blank")
        page.add_init_script(
            "const get = HTMLCanvasElement.prototype.getContext;"
            "HTMLCanvasElement.prototype.getContext = function (kind, ...more)"
            " { return kind.startsWith('webgl') ? null : get.call(this, kind, ...more); };"
        )
        page.goto(f"{server.address}/#/map")
        expect(page.get_by_text("This browser has no WebGL 2")).to_be_visible()
        expect(page.get_by_role("heading", name="Close-up")).to_be_visible()
