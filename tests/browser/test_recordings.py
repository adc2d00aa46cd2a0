"""The page Recordings and the bar of a replay, in a real browser."""

import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Page, expect

from shared.library.summary import SUFFIX
from shared.recording.summary import write_summary
from tests.browser.test_pages import judge_everywhere
from tests.support.dashboard.status_server import RunningServer, change, eventually, status_server
from tests.support.drives.meridian import record
from tests.support.patience import HANGS_S

ALL = ["download", "keep", "delete", "replay", "solve"]
NAME = "20231114T221320Z_car.mcap"


def stored(folder: Path) -> Path:
    """Put a finished recording with its summary into the folder of a recorder."""
    (folder / "recordings").mkdir()
    path = record(folder / "recordings" / NAME, 120)
    write_summary(path, path.with_name(NAME + SUFFIX))
    os.utime(path, (0, 0))
    return path


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningServer]:
    folder = tmp_path_factory.mktemp("recordings")
    stored(folder)
    with status_server(folder, recordings=ALL) as running:
        eventually(lambda: listed(running))
        yield running


def listed(server: RunningServer) -> list[dict[str, object]]:
    found = httpx.get(f"{server.address}/api/recordings", timeout=HANGS_S).json()["recordings"]
    assert isinstance(found, list)
    return found


def test_a_recording_is_shown_with_its_drive(server: RunningServer, open_page: Callable[..., Page]) -> None:
    page = open_page(server.address, path="recordings")
    row = page.locator(".recording")
    expect(row).to_contain_text("2023-11-14 22:13:20")
    expect(row).to_contain_text("1 min 59 s · 1.2 km · 1 outage · SIMULATED")
    assert (row.locator("svg path").get_attribute("d") or "").startswith("M")
    expect(row.locator(".segment.unsafe")).to_have_count(3)
    judge_everywhere(page, "recordings")


def test_a_recording_is_kept_and_deleted_only_when_that_is_confirmed(
    tmp_path: Path, open_page: Callable[..., Page]
) -> None:
    path = stored(tmp_path)
    with status_server(tmp_path, recordings=ALL) as server:
        page = open_page(server.address, path="recordings")
        page.get_by_role("button", name="Protect").click()
        expect(page.locator(".recording")).to_contain_text("protected")
        assert path.with_name(NAME + ".keep").exists()
        page.get_by_role("button", name="Release").click()
        page.get_by_role("button", name=f"Delete {NAME}").click()
        assert path.exists(), "the first click only asks"
        page.get_by_role("button", name="Delete for good").click()
        expect(page.get_by_text("There is no recording")).to_be_visible()
        assert not list(path.parent.iterdir()), "with its mark and its summary"


def test_what_the_configuration_does_not_allow_is_neither_offered_nor_done(
    tmp_path: Path, open_page: Callable[..., Page]
) -> None:
    path = stored(tmp_path)
    with status_server(tmp_path, recordings=[]) as server:
        page = open_page(server.address, path="recordings")
        expect(page.locator(".recording")).to_be_visible()
        expect(page.locator(".recording button")).to_have_count(0)
        url = f"{server.address}/api/recordings"
        for action in ("keep", "delete", "replay", "solve"):
            answer = change(server.address, "/api/recordings", {"action": action, "name": NAME})
            assert (answer.status_code, "is not allowed" in answer.text) == (403, True)
        assert httpx.get(f"{url}/{NAME}", timeout=HANGS_S).status_code == 403
        assert path.exists()


def test_no_other_site_and_no_other_file(server: RunningServer) -> None:
    url = f"{server.address}/api/recordings"
    evil = {"Origin": "http://evil.example"}
    command = {"action": "delete", "name": NAME}
    assert change(server.address, "/api/recordings", command, **evil).status_code == 403
    other = {"action": "delete", "name": "../status.address"}
    assert change(server.address, "/api/recordings", other).status_code == 404
    assert httpx.get(f"{url}/..%2Fstatus.address", timeout=HANGS_S).status_code == 404
    assert httpx.get(f"{url}/{NAME}", timeout=HANGS_S).content[:5] == b"\x89MCAP"


def test_a_file_of_another_program_gets_a_mapping(
    server: RunningServer, open_page: Callable[..., Page], tmp_path: Path
) -> None:
    table = tmp_path / "logger.csv"
    rows = "".join(f"{1_700_000_000 + s},{48.1 + s * 1e-4:.6f},11.500000,520.0\n" for s in range(80))
    table.write_text(f"time,lat,lon,alt\n{rows}")
    page = open_page(server.address, path="recordings", expected=("422",))
    card = page.get_by_role("region", name="Files of other programs")
    card.get_by_label("Choose a table").set_input_files(table)
    mapping = card.get_by_label("Mapping logger.toml")
    expect(mapping).to_have_value(re.compile(r'latitude = .*"lat"'), timeout=HANGS_S * 1e3)
    mapping.fill(mapping.input_value() + "# mine\n")
    with page.expect_download() as waiting:
        card.get_by_role("button", name="Download the mapping").click()
    assert waiting.value.suggested_filename == "logger.toml"
    assert Path(waiting.value.path()).read_text().endswith("# mine\n")
    (tmp_path / "no.csv").write_text("a,b\n1,2\n3,4\n")
    card.get_by_label("Choose a table").set_input_files(tmp_path / "no.csv")
    expect(card.get_by_role("status")).to_contain_text("No draft: ", timeout=HANGS_S * 1e3)
