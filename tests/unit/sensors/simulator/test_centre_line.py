import numpy as np
import pytest

from services.sensors.simulator.drive import simulate
from services.sensors.simulator.motion.centre_line import WIDTH_M, centre_line, road_network
from services.sensors.simulator.scenarios import SCENARIOS, Scenario, scenario_of
from shared.bus.codec import encode
from shared.maths.ellipsoid import curvature_radii
from shared.topics import BY_NAME
from tests.support.cases import each


@pytest.mark.parametrize("name", ["parking_lot", "urban", "tunnel"])
def test_the_vehicle_drives_on_the_road_that_is_published(name: str) -> None:
    scenario = scenario_of(name)
    driven = simulate(scenario, seed=3, duration_s=60.0).position[::100, :2]
    road = np.vstack([places for _, places in centre_line(scenario.course, scenario.start)])
    meridian, transverse = curvature_radii(scenario.start.latitude)
    metres = np.array([meridian, transverse * np.cos(scenario.start.latitude)])
    points, ends = driven * metres, road * metres
    along = np.diff(ends, axis=0)
    share = np.einsum("pij,ij->pi", points[:, None] - ends[:-1], along) / np.maximum((along**2).sum(1), 1e-12)
    nearest = ends[:-1] + np.clip(share, 0.0, 1.0)[..., None] * along
    off = np.linalg.norm(points[:, None] - nearest, axis=2).min(axis=1)
    assert off.max() < 0.5, "metres from the centre line"


@each("row", SCENARIOS)
def test_the_roads_of_every_scenario_fit_into_a_message(row: Scenario) -> None:
    assert len(encode(road_network(row.course, row.start, 7))) <= BY_NAME["simulation/roads"].most_bytes - 300


@pytest.mark.parametrize("scenario", SCENARIOS[:4], ids=lambda row: row.name)
def test_the_parts_of_a_course_join_and_close(scenario: object) -> None:
    row = scenario_of(scenario.name)  # type: ignore[attr-defined]
    parts = [places for _, places in centre_line(row.course, row.start)]
    for before, after in zip(parts, [*parts[1:], parts[0]], strict=True):
        assert np.abs(before[-1] - after[0]).max() * 6.4e6 < 1.0, "metre"


def test_the_tunnels_of_a_course_are_marked_and_the_message_is_small() -> None:
    row = scenario_of("tunnel")
    network = road_network(row.course, row.start, 7)
    assert [road.tunnel for road in network.roads] == [False, True, False, True, False, True, False, True, False]
    assert all(len(road.latitude_deg) == len(road.longitude_deg) and road.width_m == WIDTH_M for road in network.roads)
    assert len(network.model_dump_json()) < 30_000
