import pytest

from shared.devices.bus_watch import BusWatch
from shared.messages.operation import DeviceFound


def at(times: list[tuple[float, bool]], now_s: float) -> BusWatch:
    watch = BusWatch("can0", 0.0, lambda: now_s)
    for time_s, is_error in times:
        watch.take(is_error, time_s)
    return watch


@pytest.mark.parametrize(
    ("times", "now_s", "found", "said"),
    [
        ([], 1.0, DeviceFound.SEARCHING, "no frame so far"),
        ([], 6.0, DeviceFound.SILENT, "switch the ignition on"),
        ([(1.0, False)], 2.0, DeviceFound.WORKING, "CAN frames"),
        ([(1.0, False)], 7.0, DeviceFound.SILENT, "no frame on can0"),
        ([(1.0, True)], 2.0, DeviceFound.NOISE, "bitrate is probably not that of the bus"),
        ([(1.0, True), (1.1, False)], 2.0, DeviceFound.WORKING, "1 error frames so far: check the termination"),
        ([(1.0, True)], 9.0, DeviceFound.SILENT, "no frame on can0"),
    ],
)
def test_a_bus_is_judged_by_its_frames(
    times: list[tuple[float, bool]], now_s: float, found: DeviceFound, said: str
) -> None:
    watch = at(times, now_s)
    assert watch.found is found and said in watch.sentence()
