"""`obu calibrate imu`: rest is found, and the settings of the vehicle's file come out."""

import json
import tomllib
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from cli.calibrate.allan import FloatArray
from cli.calibrate.imu import calibrate_imu
from cli.calibrate.rest import gaps, longest_rest
from cli.import_drive.conversion.convert import Conversion
from cli.import_drive.output import Part, write
from cli.progress import progress_on
from services.core.fusion.settings import ImuSettings
from shared.errors import UserError
from shared.messages.imu import ImuSamples
from shared.runtime.config import parse_vehicle
from tests.support.cases import each

NS = 1_000_000_000
RATE_HZ = 50.0
FORCE_SD, RATE_SD = 0.01, 0.001  # of a sample


def samples(seconds: float, seed: int = 1) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Stamps, forces and rates of a sensor at rest."""
    count = round(seconds * RATE_HZ)
    random = np.random.default_rng(seed)
    forces = random.normal((0.1, 0.2, -9.8), FORCE_SD, (count, 3))
    return np.arange(count) / RATE_HZ, forces, random.normal(0.0, RATE_SD, (count, 3))


def recorded(folder: Path, seconds: float) -> Path:
    stamps, forces, rates = samples(seconds)
    messages = [
        ImuSamples(
            received_ns=(at := 1_700_000_000 * NS + round(stamps[k] * NS)), source="imu0", sampled_ns=(at,),
            specific_force_body_m_s2=(tuple(forces[k].tolist()),), angular_rate_body_rad_s=(tuple(rates[k].tolist()),),
        )
        for k in range(len(stamps))
    ]  # fmt: skip
    path = folder / "rest.mcap"
    part = Part("rest", "", Conversion(messages, len(messages), Counter()))
    with progress_on(Console(stderr=True)) as progress:
        write(path, [part], parse_vehicle(""), {"name": "rest"}, progress)
    return path


def test_rest_is_what_is_between_two_movements() -> None:
    stamps, forces, rates = samples(100.0)
    forces[:500] += np.sin(np.arange(500))[:, None]
    rates[3500:3600, 2] += 0.1  # a slow turn
    rest = longest_rest(stamps, forces, rates)
    assert rest is not None
    assert rest.first_s == pytest.approx(10.0, abs=1.0)
    assert rest.duration_s == pytest.approx(60.0, abs=2.0)
    assert rest.step_s == pytest.approx(1.0 / RATE_HZ)


def test_rest_ends_at_a_gap() -> None:
    stamps, forces, rates = samples(60.0)
    stamps[2000:] += 1.0
    rest = longest_rest(stamps, forces, rates)
    assert rest is not None and rest.duration_s == pytest.approx(40.0, abs=1.0)


def uneven(kind: str, rate_hz: float, duration_s: float = 40.0) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Stamps [s] of samples at an even rate: rounded down to milliseconds, each late by itself, or ten at a time."""
    even = np.arange(int(rate_hz * duration_s)) / rate_hz
    if kind == "milliseconds":
        return np.floor(even * 1e3 + 1e-6) / 1e3
    if kind == "late":
        return even + np.random.default_rng(1).uniform(0.0, 0.8 / rate_hz, len(even))
    return (np.arange(len(even)) // 10 * 10 + 9) / rate_hz + np.arange(len(even)) % 10 * 1e-4


@each("kind", ["milliseconds", "late", "batches"])
@each("rate_hz", [100.0, 333.3, 400.0, 800.0])
@each("missing", [0, 1, 50])
def test_a_gap_is_a_missing_sample_and_no_late_stamp(kind: str, rate_hz: float, missing: int) -> None:
    stamps, cut = uneven(kind, rate_hz), int(rate_hz * 10.0)
    stamps = np.delete(stamps, slice(cut, cut + missing))
    forces, rates = np.random.default_rng(2).normal(0.0, 0.01, (2, len(stamps), 3))
    rest = longest_rest(stamps, forces, rates)
    assert rest is not None and rest.step_s == pytest.approx(1.0 / rate_hz, rel=2e-3)
    assert rest.duration_s == pytest.approx(30.0 if missing else 40.0, abs=2.1)
    found = gaps(stamps)
    assert len(found) == (2 if missing else 0)
    assert all(0 <= k - cut <= rate_hz for k in found) or np.abs(found - cut).min() <= 20


def test_of_two_samples_there_is_no_rest() -> None:
    assert longest_rest(*(sample[:2] for sample in samples(1.0))) is None


def test_the_section_is_accepted_by_the_unit_and_holds_what_was_measured(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "noise.html"
    assert calibrate_imu(recorded(tmp_path, 90.0), page, as_json=True) == 0
    result = json.loads(capsys.readouterr().out)
    table = tomllib.loads(result["section"])["core"]["fusion"]["imu"]
    settings = ImuSettings(**table)
    assert settings.angle_random_walk_rad_sqrt_s == pytest.approx(RATE_SD / np.sqrt(RATE_HZ), rel=0.1)
    assert settings.velocity_random_walk_m_s_sqrt_s == pytest.approx(FORCE_SD / np.sqrt(RATE_HZ), rel=0.1)
    assert result["source"] == "imu0" and result["rate_hz"] == pytest.approx(RATE_HZ, rel=1e-3)
    html = page.read_text()
    assert (
        html.count("<svg") == 2
        and "angle_random_walk_rad_sqrt_s" in html
        and "http://" not in html.replace("http://www.w3.org", "")
    )


def test_too_short_a_rest_says_what_to_record(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="record an hour with the vehicle standing"):
        calibrate_imu(recorded(tmp_path, 30.0), tmp_path / "noise.html")


def test_a_page_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "noise.html").write_text("")
    with pytest.raises(UserError, match="--out"):
        calibrate_imu(tmp_path / "rest.mcap", tmp_path / "noise.html")
