"""What the wheel holds: everything that commands read, and the licences of what it gives away."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from deploy import wheel
from shared import VERSION
from shared.page.pages import read_pages
from tests.support.data import REPOSITORY
from tests.support.wheel import built

LIBRARIES = f"{wheel.DASHBOARD}/node_modules"


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    with zipfile.ZipFile(built(folder)) as archive:
        archive.extractall(folder)
    return folder


def test_it_holds_every_file_of_the_code_and_what_lies_beside_it(unpacked: Path) -> None:
    listed = subprocess.run(
        ["git", "ls-files", *wheel.FOLDERS], cwd=REPOSITORY, capture_output=True, text=True, check=True
    ).stdout.split()
    tracked = {name for name in listed if not Path(name).name.startswith(".") and (REPOSITORY / name).exists()}
    assert {"broker/mosquitto.conf", "broker/start.sh", "broker/probe.py", "deploy/vehicles/simulated.toml"} <= tracked
    assert sorted(name for name in tracked if not (unpacked / name).is_file()) == []


def test_it_holds_nothing_of_tests_tools_or_the_libraries_that_the_page_does_not_need(unpacked: Path) -> None:
    top = {path.name for path in unpacked.iterdir() if path.suffix != ".whl"}
    assert top == {"broker", "cli", "deploy", "services", "shared", f"obu-{VERSION}.dist-info"}
    assert {path.name for path in (unpacked / "deploy").iterdir()} == {"vehicles", "plazas", "trust"}
    libraries = unpacked / LIBRARIES
    held = {path.relative_to(libraries).as_posix() for path in libraries.rglob("*") if path.is_file()}
    assert held == wheel.library_files() | {wheel.LICENCES}


def test_the_page_is_complete_from_the_wheel(unpacked: Path) -> None:
    here, there = read_pages(REPOSITORY / wheel.DASHBOARD), read_pages(unpacked / wheel.DASHBOARD)
    assert there.version == here.version


def test_words_are_there_without_the_control_centre(unpacked: Path) -> None:
    said = "from shared.words import words; print(words.__file__, words.words('de').name('state', 'safe'))"
    done = subprocess.run(
        [sys.executable, "-c", said], cwd=unpacked, env={**os.environ, "PYTHONPATH": str(unpacked)},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout.split() == [str(unpacked / "shared/words/words.py"), "SAFE"]


def test_every_library_and_what_is_bundled_in_it_has_its_licence(unpacked: Path) -> None:
    text = (unpacked / LIBRARIES / wheel.LICENCES).read_text(encoding="utf-8")
    for package in ("preact", "htm", "uplot", "maplibre-gl", "pmtiles", "fflate", "swagger-ui-dist", "earcut"):
        assert f"\n{package} " in text
    assert text.count("\n" + "=" * 79) == len(wheel.packages(REPOSITORY / wheel.DASHBOARD))


def package(name: str, licence: str, *texts: str) -> wheel.Package:
    return wheel.Package(name, "1.0", licence, "A. Author", "https://example.org", texts)


def test_a_package_without_a_text_names_its_author_and_where_the_conditions_stand() -> None:
    text = wheel.licences([package("one", "MIT"), package("two", "MIT", "the conditions")])
    assert (
        "Copyright A. Author (https://example.org). Its package holds no text; the conditions are those under two."
        in text
    )


def test_a_package_whose_licence_is_nowhere_is_refused() -> None:
    with pytest.raises(wheel.WheelIncomplete, match=r"one 1\.0 holds no licence"):
        wheel.licences([package("one", "Other"), package("two", "MIT", "the conditions")])
