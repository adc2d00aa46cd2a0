from collections.abc import Iterable, Sequence
from itertools import pairwise

import pytest

from services.controller.mode.configuration_exchange import ConfigurationExchange
from services.controller.mode.process import Config, Process
from services.controller.mode.sources import MAX_SOURCES, Sources
from shared.messages.base import Message, Tick
from shared.messages.gnss import FixType, GnssConfiguration, GnssConfigure, GnssFix, GnssOutput, GnssReceiver
from shared.messages.imu import ImuSamples
from shared.messages.navigation import LastPosition, NavigationPhase, NavigationSolution, NavigationState
from shared.messages.operation import Mode, ModeState
from shared.messages.power import PowerState
from shared.messages.vehicle import VehicleSpeed

NS = 1_000_000_000
START_NS = 1_764_000_000 * NS
BOOT_ERROR_NS = 3600 * NS  # error of the host's clock: UTC is one hour ahead of the time line


def at(second: float) -> int:
    return START_NS + round(second * NS)


def fix(second: float, *, good: bool = True, source: str = "gnss0") -> GnssFix:
    return GnssFix(
        sampled_ns=at(second), received_ns=at(second), source=source,
        fix_type=FixType.THREE_D if good else FixType.NONE,
        latitude_deg=42.0 if good else None, utc_ns=at(second) + BOOT_ERROR_NS if good else None,
    )  # fmt: skip


def imu(second: float, source: str = "imu0") -> ImuSamples:
    zero = ((0.0, 0.0, 0.0),)
    return ImuSamples(
        received_ns=at(second), source=source, sampled_ns=(at(second),),
        specific_force_body_m_s2=zero, angular_rate_body_rad_s=zero,
    )  # fmt: skip


def speed(second: float, source: str = "can0/obd") -> VehicleSpeed:
    return VehicleSpeed(sampled_ns=at(second), received_ns=at(second), source=source, speed_m_s=1.0)


def state(second: float, phase: NavigationPhase = NavigationPhase.NAVIGATING) -> NavigationState:
    return NavigationState(
        sampled_ns=at(second), phase=phase, since_ns=0, reason="because", fixes_used=0, fixes_rejected=0,
        samples_used=0, samples_rejected=0, imu_gaps=0, resets=0,
    )  # fmt: skip


def solution(
    second: float, *, stationary: bool = False, phase: NavigationPhase = NavigationPhase.NAVIGATING
) -> NavigationSolution:
    return NavigationSolution(
        sampled_ns=at(second), phase=phase, latitude_deg=42.0, longitude_deg=13.0, height_ellipsoid_m=700.0,
        velocity_ned_m_s=(0, 0, 0), roll_rad=0, pitch_rad=0, yaw_rad=1.0, position_cov_ned_m2=(4, 0, 0, 9, 0, 16),
        velocity_cov_ned_m2_s2=(1, 0, 0, 1, 0, 1), attitude_cov_ned_rad2=(1, 0, 0, 1, 0, 0.25),
        angular_rate_body_rad_s=(0, 0, 0), accelerometer_bias_m_s2=(0, 0, 0), gyroscope_bias_rad_s=(0, 0, 0),
        stationary=stationary,
    )  # fmt: skip


def configuration(request_id: int, *, accepted: bool = True, reason: str | None = None) -> GnssConfiguration:
    return GnssConfiguration(request_id=request_id, source="gnss0", accepted=accepted, reason=reason)


def feed(process: Process, messages: Iterable[Message]) -> list[Message]:
    return [output for message in messages for output in process.handle(message)]


def modes(messages: Sequence[Message]) -> list[Mode]:
    """The modes in order, without repetitions."""
    found = [message.mode for message in messages if isinstance(message, ModeState)]
    return [mode for k, mode in enumerate(found) if k == 0 or mode is not found[k - 1]]


def newest(messages: Sequence[Message]) -> ModeState:
    return [message for message in messages if isinstance(message, ModeState)][-1]


def requests(messages: Sequence[Message]) -> list[GnssConfigure]:
    return [message for message in messages if isinstance(message, GnssConfigure)]


def healthy_second(second: int) -> list[Message]:
    """One second of a unit that navigates."""
    return [Tick(now_ns=at(second)), fix(second + 0.1), state(second + 0.2), solution(second + 0.3), imu(second + 0.4)]


def test_the_modes_of_a_start_are_boot_detecting_configuring_aligning_measuring() -> None:
    process = Process(Config())
    out = feed(process, [Tick(now_ns=at(0)), Tick(now_ns=at(1)), Tick(now_ns=at(2)), imu(2.1), fix(2.2)])
    (request,) = requests(out)
    out += feed(process, [Tick(now_ns=at(3)), configuration(request.request_id)])
    out += feed(process, [state(3.1, NavigationPhase.LEVELLING), Tick(now_ns=at(4)), imu(4.1)])
    out += feed(process, [state(4.2), solution(4.3), Tick(now_ns=at(5))])
    assert modes(out) == [Mode.BOOT, Mode.DETECTING, Mode.CONFIGURING, Mode.ALIGNING, Mode.MEASURING]
    assert newest(out).since_ns == at(4.3)
    assert out[-1] == newest(out)
    assert [message.mode for message in process.close() if isinstance(message, ModeState)] == [Mode.SHUTTING_DOWN]


def test_the_state_is_published_once_a_second_and_when_it_changes() -> None:
    process = Process(Config(configure_gnss=False))
    feed(process, [message for second in range(5) for message in healthy_second(second)])
    assert feed(process, [imu(5.05), solution(5.1), state(5.2), fix(5.3)]) == []
    assert len(feed(process, [Tick(now_ns=at(6))])) == 1
    (changed,) = feed(process, [solution(6.1, phase=NavigationPhase.COASTING)])
    assert isinstance(changed, ModeState)
    assert (changed.mode, changed.since_ns) == (Mode.DEGRADED, at(6.1))


def test_a_lost_imu_degrades_the_mode_within_3_s_until_samples_return() -> None:
    process = Process(Config(configure_gnss=False))
    feed(process, [message for second in range(5) for message in healthy_second(second)])
    out = feed(process, [message for k in range(5, 10) for message in (Tick(now_ns=at(k)), fix(k + 0.1))])
    assert newest(out).reason == "no IMU samples for 5 s"
    assert next(m.sampled_ns for m in out if isinstance(m, ModeState) and m.mode is Mode.DEGRADED) <= at(8)
    out = feed(process, [imu(10.0), state(10.1), solution(10.2)])
    assert newest(out).mode is Mode.MEASURING


def test_the_reason_in_a_tunnel_is_the_missing_gnss_fix() -> None:
    process = Process(Config(configure_gnss=False))
    feed(process, [message for second in range(5) for message in healthy_second(second)])
    coasting = NavigationPhase.COASTING
    out = feed(process, [
        message for k in range(5, 17)
        for message in (Tick(now_ns=at(k)), imu(k), fix(k + 0.1, good=False), solution(k + 0.2, phase=coasting))
    ])  # fmt: skip
    assert newest(out).mode is Mode.DEGRADED
    assert newest(out).reason == "no GNSS fix for 12 s: coasting"
    assert newest(out).gnss_source == "gnss0"


def test_a_receiver_is_configured_with_the_configured_period_and_messages() -> None:
    process = Process(Config(navigation_period_s=0.2, gnss_outputs=(GnssOutput.FIX,), gnss_dynamic_model=""))
    (request,) = requests(feed(process, [fix(0.0)]))
    assert (request.source, request.navigation_period_s, request.outputs) == ("gnss0", 0.2, (GnssOutput.FIX,))
    assert request.dynamic_model is None


def test_a_receiver_with_ubx_and_nmea_output_is_configured_once() -> None:
    process = Process(Config())
    out = feed(process, [fix(0.0, source="gnss0/nmea"), fix(0.1), fix(1.0, source="gnss0/nmea"), fix(1.1)])
    assert [request.source for request in requests(out)] == ["gnss0"]


def test_a_reconnected_receiver_is_configured_again() -> None:
    process = Process(Config())
    (first,) = requests(feed(process, [fix(0.0)]))
    feed(process, [configuration(first.request_id), fix(1.0), fix(2.0)])
    (second,) = requests(feed(process, [Tick(now_ns=at(10)), fix(20.0)]))
    assert second.request_id != first.request_id


def test_no_receiver_is_configured_if_configure_gnss_is_false() -> None:
    assert not requests(feed(Process(Config(configure_gnss=False)), [fix(0.0), Tick(now_ns=at(1))]))


def test_a_rejected_configuration_is_retried_three_times_with_back_off_and_then_reported() -> None:
    process, requested_s, out = Process(Config()), [], []
    for k in range(60):
        out = feed(process, [Tick(now_ns=at(k)), *healthy_second(k)[1:]])
        for request in requests(out):
            requested_s.append(k)
            feed(process, [configuration(request.request_id, accepted=False, reason="it does not send NAV-COV")])
    assert len(requested_s) == 4
    assert [b - a for a, b in pairwise(requested_s)] == pytest.approx([2, 4, 8], abs=1)
    assert newest(out).mode is Mode.MEASURING
    assert newest(out).reason == "navigating; receiver not configured: it does not send NAV-COV"


def test_a_missing_response_is_handled_as_a_rejection() -> None:
    exchange = ConfigurationExchange("gnss0", 1.0, (GnssOutput.FIX,), None)
    sent = [*exchange.start(at(0))] + [request for k in range(200) for request in exchange.tick(at(k))]
    assert len(sent) == 4
    assert exchange.fault == "no response from parsers.gnss"
    assert exchange.configuring is None


def test_a_response_to_an_earlier_request_is_ignored() -> None:
    exchange = ConfigurationExchange("gnss0", 1.0, (GnssOutput.FIX,), None)
    (request,) = exchange.start(at(0))
    exchange.response(configuration(request.request_id - 1), at(0))
    assert exchange.configuring is not None
    exchange.response(configuration(request.request_id), at(0))
    assert exchange.configuring is None


def test_a_source_remains_selected_until_it_is_silent() -> None:
    sources = Sources(silent_s=3.0)
    assert sources.choose(0) is None
    assert sources.note_received("front", 0)
    assert sources.note_received("rear", 0)
    assert sources.choose(0) == "front"
    assert not sources.note_received("rear", 5 * NS // 2)
    assert sources.choose(5 * NS // 2) == "front"
    assert sources.choose(4 * NS) == "rear"
    assert sources.note_received("front", 4 * NS)
    assert sources.choose(4 * NS) == "rear"  # the selected source remains
    assert sources.age_s(6 * NS) == 2.0
    assert sources.choose(60 * NS) is None


def test_a_source_of_lower_rank_is_selected_at_once() -> None:
    sources = Sources(silent_s=3.0)
    sources.note_received("gnss0/nmea", 0, rank=1)
    assert sources.choose(0) == "gnss0/nmea"
    sources.note_received("gnss0", NS, rank=0)
    assert sources.choose(NS) == "gnss0"


def test_the_number_of_sources_is_bounded() -> None:
    sources = Sources(silent_s=3.0)
    assert sum(sources.note_received(f"gnss{k}", 0) for k in range(1000)) == MAX_SOURCES


def test_one_source_of_each_kind_is_selected() -> None:
    process = Process(Config(configure_gnss=False))
    out = newest(feed(process, [fix(0.0), imu(0.1), speed(0.2), speed(0.3, "can0/j1939"), Tick(now_ns=at(1))]))
    assert (out.gnss_source, out.imu_source, out.speed_source) == ("gnss0", "imu0", "can0/j1939")


def kept(messages: Sequence[Message]) -> list[float]:
    return [(m.sampled_ns - START_NS) / NS for m in messages if isinstance(m, LastPosition)]


def test_the_position_is_stored_every_10_s_and_when_the_vehicle_stops() -> None:
    process = Process(Config())
    out = feed(process, [solution(k * 0.5, stationary=26.0 <= k * 0.5 < 40.0) for k in range(100)])
    assert kept(out) == [0.0, 10.0, 20.0, 26.0, 36.0, 46.0]


def test_the_stored_position_has_utc_and_standard_deviations() -> None:
    process = Process(Config(configure_gnss=False))
    out = feed(process, [fix(0.0), solution(1.0)])
    (position,) = [message for message in out if isinstance(message, LastPosition)]
    assert position.position_sd_ned_m == (2.0, 3.0, 4.0)
    assert (position.yaw_rad, position.yaw_sd_rad) == (1.0, 0.5)
    assert position.utc_ns == at(1.0) + BOOT_ERROR_NS


def test_without_gnss_time_the_stored_position_has_no_utc() -> None:
    (position,) = [m for m in feed(Process(Config()), [solution(1.0)]) if isinstance(m, LastPosition)]
    assert position.utc_ns is None


def test_while_coasting_the_position_is_stored_at_shutdown_only() -> None:
    process = Process(Config())
    coasting = NavigationPhase.COASTING
    out = feed(process, [solution(0.0), *(solution(k, phase=coasting) for k in range(1, 60))])
    assert kept(out) == [0.0]
    assert kept(list(process.close())) == [59.0]


def test_shutdown_stores_the_newest_position_once() -> None:
    process = Process(Config())
    feed(process, [solution(0.0), solution(3.0)])
    outputs = list(process.close())
    assert kept(outputs) == [3.0]
    assert newest(outputs).mode is Mode.SHUTTING_DOWN
    assert kept(list(process.close())) == []


def test_the_stored_position_of_an_earlier_run_causes_no_output() -> None:
    process = Process(Config())
    (saved,) = [m for m in feed(Process(Config()), [solution(1.0)]) if isinstance(m, LastPosition)]
    assert feed(process, [saved]) == []
    assert kept(list(process.close())) == []


def test_equal_messages_give_equal_outputs() -> None:
    script: list[Message] = [message for second in range(30) for message in healthy_second(second)]
    assert feed(Process(Config()), script) == feed(Process(Config()), script)


def sends(second: float, *messages: str, other: int = 0) -> GnssReceiver:
    return GnssReceiver(
        received_ns=at(second),
        source="gnss0",
        messages=messages,
        received_bytes=500,
        other_bytes=other,
        gives_position=bool({"NMEA GGA", "UBX NAV-PVT"} & set(messages)),
    )


def test_a_receiver_without_a_fix_is_configured_by_its_bytes_and_once() -> None:
    process = Process(Config())
    outputs = feed(
        process, [Tick(now_ns=at(0.0)), imu(0.5), sends(1.0, "UBX NAV-POSLLH"), sends(3.0, "UBX NAV-POSLLH")]
    )
    [request] = [message for message in outputs if isinstance(message, GnssConfigure)]
    assert request.source == "gnss0" and GnssOutput.FIX in request.outputs
    assert newest(outputs).mode is Mode.CONFIGURING
    again = feed(process, [fix(4.0, good=False), sends(5.0, "UBX NAV-PVT")])
    assert not [message for message in again if isinstance(message, GnssConfigure)], "it is the same receiver"


def test_a_receiver_that_was_unplugged_is_configured_again() -> None:
    outputs = feed(Process(Config()), [Tick(now_ns=at(0.0)), sends(1.0, "NMEA GGA"), sends(20.0, "NMEA GGA")])
    assert len([message for message in outputs if isinstance(message, GnssConfigure)]) == 2


@pytest.mark.parametrize(
    ("said", "reason"),
    [
        (("UBX NAV-POSLLH", "UBX NAV-SOL"), "sends no message that gives a position, but UBX NAV-POSLLH, UBX NAV-SOL"),
        (("NMEA GGA",), "has no position yet: give its antenna a view of the sky (it sends NMEA GGA)"),
        ((), "sends bytes that are no messages: check the baud rate of its device"),
    ],
)
def test_a_receiver_whose_bytes_arrive_is_named_by_them_and_its_cable_is_not_suspected(
    said: tuple[str, ...], reason: str
) -> None:
    process = Process(Config(configure_gnss=False))
    messages = [Tick(now_ns=at(0.0)), sends(2.0, *said, other=0 if said else 500), imu(2.0), Tick(now_ns=at(2.5))]
    shown = newest(feed(process, messages))
    assert (shown.mode, shown.reason) == (Mode.DETECTING, f"gnss0 {reason}")
    silent = newest(feed(process, [imu(20.0), Tick(now_ns=at(20.0))]))
    assert silent.reason.startswith("no data from the GNSS receiver yet: check its cable")


def test_a_statement_that_the_broker_kept_of_an_earlier_run_starts_nothing() -> None:
    assert feed(Process(Config()), [sends(-3600.0, "UBX NAV-PVT")]) == []


def test_a_receiver_without_a_position_gives_way_to_one_that_has_it() -> None:
    """Both send all the time: silence would never decide."""
    process = Process(Config(configure_gnss=False))
    out: list[Message] = []
    for k in range(40):
        messages = [fix(k, good=k < 10), fix(k + 0.1, source="gnss1"), Tick(now_ns=at(k + 0.5))]
        out += feed(process, messages)
    chosen = [message.gnss_source for message in out if isinstance(message, ModeState)]
    assert chosen[8] == "gnss0" and chosen[-1] == "gnss1"
    (switch,) = newest(out).switches
    assert (switch.kind, switch.before, switch.after) == ("gnss", "gnss0", "gnss1")
    assert "no valid message of gnss0 for 3 s" in switch.reason
    assert switch.sampled_ns < at(14)


def test_a_selection_does_not_follow_single_standard_deviations() -> None:
    sources = Sources(5.0, "gnss")
    for k in range(100):
        sources.note_received("a", k * NS, sd=2.0)
        sources.note_received("b", k * NS, sd=0.5 if k % 5 else 1.5)
        assert sources.choose(k * NS) == "a"
    for k in range(100, 120):
        sources.note_received("a", k * NS, sd=2.0)
        sources.note_received("b", k * NS, sd=0.5)
        sources.choose(k * NS)
    assert sources.chosen == "b"
    assert len(sources.switches) == 1


def test_what_the_operator_wants_is_used_while_it_is_valid() -> None:
    sources = Sources(5.0, "imu")
    for k in range(20):
        sources.note_received("a", k * NS)
        sources.note_received("b", k * NS, valid=k < 10)
        sources.wanted = "b" if k >= 3 else None
        assert sources.choose(k * NS) == ("a" if k < 3 or k > 12 else "b")


def power(second: float, *, low: bool) -> PowerState:
    return PowerState(
        sampled_ns=at(second), source="ups", on_battery=True, low=low, reason="battery nearly empty, about 8% left"
    )


def test_a_battery_that_is_nearly_empty_shuts_down_and_stores_the_position_and_mains_end_it() -> None:
    process = Process(Config())
    feed(process, [message for second in range(12) for message in healthy_second(second)])
    stored = feed(process, [power(12.1, low=True)])
    state = newest(stored)
    assert (state.mode, state.power_off) == (Mode.SHUTTING_DOWN, True) and "8% left" in state.reason
    assert len([message for message in stored if isinstance(message, LastPosition)]) == 1
    again = feed(process, [power(13.1, low=True), Tick(now_ns=at(14.0))])
    assert newest(again).power_off and not any(isinstance(message, LastPosition) for message in again)
    back = newest(feed(process, [power(14.1, low=False), *healthy_second(15)]))
    assert not back.power_off and back.mode is not Mode.SHUTTING_DOWN


def test_a_supply_that_falls_silent_shuts_nothing_down() -> None:
    process = Process(Config())
    feed(process, [message for second in range(12) for message in healthy_second(second)])
    assert newest(feed(process, [power(12.1, low=True)])).power_off
    assert not newest(feed(process, [*healthy_second(18), Tick(now_ns=at(18.5))])).power_off
