"""Neighbours of the simulated vehicle: consistency of their motion and of the radio measurements."""

from itertools import islice, pairwise

import numpy as np
import pytest

from services.sensors.simulator.scenarios import BY_NAME
from services.sensors.simulator.v2x.radio import CFO_SD_HZ, range_rate
from services.sensors.simulator.v2x.traffic import MAX_COUNT, Car, Traffic
from services.sensors.simulator.vehicle import Vehicle, antenna_at
from services.sensors.simulator.world import DEFAULT_START_NS, Equipment, World
from shared.attacks import schedule
from shared.maths.earth import Geodetic, ecef_from_geodetic, geodetic_from_ned_difference, ned_from_ecef
from shared.maths.frequency_offset import range_rate_from_cfo
from shared.messages.base import Message
from shared.messages.navigation import TruthState
from shared.messages.neighbours import Neighbour, NeighbourStates

STEP_S = 0.01


def received(scenario: str, seed: int = 1, count: int = 4, seconds: int = 60) -> list[NeighbourStates]:
    world = World(BY_NAME[scenario], seed, DEFAULT_START_NS, Equipment(neighbours=count))
    return list(islice((message for _, message in world if isinstance(message, NeighbourStates)), seconds))


def place_e(origin: Geodetic, away_n: np.ndarray) -> np.ndarray:
    north, east, down = away_n.tolist()
    return np.array(ecef_from_geodetic(geodetic_from_ned_difference((north, east, down), origin)))


@pytest.mark.parametrize("scenario", ["urban", "highway", "parking_lot"])
def test_velocities_and_range_rates_are_the_derivatives_of_positions_and_distances(scenario: str) -> None:
    motion = Vehicle(BY_NAME[scenario], 3, STEP_S).advance(6000).motion
    traffic = Traffic(BY_NAME[scenario], 3, MAX_COUNT)
    compared = 0
    for node in range(2000, 5900, 130):
        nodes = (node - 1, node, node + 1)
        here = [Geodetic(*motion.position[k].tolist()) for k in nodes]
        cars = [traffic.at(k * STEP_S) for k in nodes]
        antennas = [np.array(ecef_from_geodetic(antenna_at(motion, k).position)) for k in nodes]
        to_ned = ned_from_ecef(here[1].latitude, here[1].longitude)
        for before, car, after in zip(*cars, strict=True):
            if not before.station_id == car.station_id == after.station_id:
                continue
            places = [place_e(here[0], before.position_n), place_e(here[2], after.position_n)]
            velocity_n = to_ned @ (places[1] - places[0]) / (2.0 * STEP_S)
            assert np.abs(velocity_n - car.velocity_n).max() < 0.01
            near, far = (np.linalg.norm(place - antennas[k]) for place, k in zip(places, (0, 2), strict=True))
            rate = float(far - near) / (2.0 * STEP_S)
            assert abs(rate - range_rate(car, here[1], antenna_at(motion, node))) < 0.03
            compared += 1
    assert compared > 150


def test_without_noise_the_offset_gives_the_range_rate_back_once_the_oscillators_are_known() -> None:
    world = World(BY_NAME["urban"], 2, DEFAULT_START_NS, Equipment(neighbours=6))
    states = [message for _, message in islice(world, 30_000) if isinstance(message, NeighbourStates)]
    motion = Vehicle(BY_NAME["urban"], 2, world.step_ns * 1e-9).advance(100 * len(states)).motion
    traffic = Traffic(BY_NAME["urban"], 2, 6)
    common = []
    for k, state in enumerate(states, 1):
        here = Geodetic(*motion.position[100 * k].tolist())
        cars: tuple[Car, ...] = traffic.at(100 * k * world.step_ns * 1e-9)
        for car, neighbour in zip(cars, state.neighbours, strict=True):
            assert (
                car.station_id == neighbour.station_id
                and neighbour.cfo_hz is not None
                and neighbour.oscillator_offset is not None
            )
            measured = range_rate_from_cfo(neighbour.cfo_hz, neighbour.oscillator_offset, 0.0)
            common.append(measured - range_rate(car, here, antenna_at(motion, 100 * k)))  # c y_r and noise
    spread = float(np.diff(np.array(common).reshape(-1, 6)[:, :2]).std() / np.sqrt(2.0))
    assert len(states) > 100 and abs(spread - CFO_SD_HZ * 0.0508) < 0.15


@pytest.mark.parametrize("count", [0, 2, 6])
def test_the_configured_number_of_neighbours_is_near(count: int) -> None:
    world = World(BY_NAME["highway"], 1, DEFAULT_START_NS, Equipment(neighbours=count))
    truth: TruthState | None = None
    for _, message in islice(world, 20_000):
        truth = message if isinstance(message, TruthState) else truth
        if isinstance(message, NeighbourStates) and truth is not None:
            assert len(message.neighbours) == count == len({neighbour.station_id for neighbour in message.neighbours})
            for neighbour in message.neighbours:
                apart = np.radians(
                    [neighbour.latitude_deg - truth.latitude_deg, neighbour.longitude_deg - truth.longitude_deg]
                )
                assert np.abs(apart).max() * 6.4e6 < 600.0


def test_the_same_seed_gives_the_same_neighbours_and_another_one_others() -> None:
    assert received("urban") == received("urban") != received("urban", seed=2)


def test_neighbours_do_not_change_the_bytes_of_the_devices() -> None:
    def rest(count: int) -> list[Message]:
        world = World(BY_NAME["urban"], 1, DEFAULT_START_NS, Equipment(neighbours=count))
        return [m for _, m in islice(world, 5000) if not isinstance(m, NeighbourStates)][:4800]

    assert rest(0) == rest(6)


def test_false_neighbours_add_one_offset_to_their_published_states_only() -> None:
    true_states, false_states = received("urban", seconds=5), []
    lie = schedule("neighbour_collusion(neighbours=2,speed=3)@0")
    world = World(BY_NAME["urban"], 1, DEFAULT_START_NS, Equipment(neighbours=4), [lie])
    false_states = list(islice((message for _, message in world if isinstance(message, NeighbourStates)), 5))
    for true, published in zip(true_states, false_states, strict=True):
        pairs: list[tuple[Neighbour, Neighbour]] = list(zip(true.neighbours, published.neighbours, strict=True))
        for number, (a, b) in enumerate(pairs):
            added = np.subtract(b.velocity_ned_m_s, a.velocity_ned_m_s)
            assert np.isclose(np.linalg.norm(added), 3.0 if number < 2 else 0.0)
            assert b.model_copy(update={"velocity_ned_m_s": a.velocity_ned_m_s}) == a


def test_oncoming_and_parked_cars_are_followed_by_others() -> None:
    states = received("highway", count=4, seconds=80)
    for column in (1, 3):
        ids = [state.neighbours[column].station_id for state in states]
        assert sum(a != b for a, b in pairwise(ids)) >= 3
