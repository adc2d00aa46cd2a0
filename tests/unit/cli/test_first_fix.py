"""`obu kpi ttff`: restarts of the simulated receiver, of one that never finds a fix, and of one without any."""

import json
from collections.abc import Iterator

import numpy as np
import pytest
from typer.testing import CliRunner

from cli.kpi.first_fix import SimulatedReceiver, times_to_first_fix
from cli.main import command_line
from services.parsers.gnss.ubx.reset import reset
from services.sensors.simulator.gnss.receiver_settings import Settings
from services.sensors.simulator.gnss.reception import search_s
from shared.errors import UserError
from shared.messages.gnss import GnssRaw, GnssStart
from tests.support.cases import each


def test_each_start_is_told_by_what_it_clears() -> None:
    for start in GnssStart:
        settings = Settings(("ubx",))
        assert not list(settings.feed(reset(start))) and settings.restart is start


@each(
    ("start", "least_s", "most_s"),
    [(GnssStart.HOT, 2.0, 4.0), (GnssStart.WARM, 19.0, 33.0), (GnssStart.COLD, 20.0, 37.0)],
)
def test_the_times_are_those_of_the_simulated_search(start: GnssStart, least_s: float, most_s: float) -> None:
    times = list(times_to_first_fix(SimulatedReceiver(), start, 2))
    assert len(times) == 2 and all(time is not None and least_s < time < most_s for time in times)
    drawn = [search_s(start, np.random.default_rng(seed)) for seed in range(50)]
    assert least_s <= min(drawn) and max(drawn) <= most_s


def test_the_command_prints_mean_and_deviation() -> None:
    app = command_line(["kpi", "ttff"])
    done = CliRunner().invoke(app, ["kpi", "ttff", "hot", "--repeat", "3", "--json"])
    found = json.loads(done.stdout.splitlines()[-1])
    assert done.exit_code == 0 and found["restarts"] == 3 and found["without_fix"] == 0
    assert found["mean_s"] == pytest.approx(np.mean(found["times_s"])) and "assumptions" in found["receiver"]
    assert found["sigma_s"] == pytest.approx(np.std(found["times_s"], ddof=1))


class Deaf(SimulatedReceiver):
    """A receiver that loses its signals with the restart, and sends nothing but bytes without a fix."""

    def __init__(self) -> None:
        super().__init__()
        self.written_ns: int | None = None

    def read(self) -> Iterator[GnssRaw]:
        """Bytes, empty after the restart."""
        for raw in super().read():
            yield raw if self.written_ns is None else raw.model_copy(update={"data": b""})

    def write(self, data: bytes, now_ns: int) -> None:
        """Note when."""
        self.written_ns = now_ns


def test_a_restart_without_a_fix_is_one_without_a_time() -> None:
    assert list(times_to_first_fix(Deaf(), GnssStart.COLD, 1)) == [None]


def test_a_receiver_without_a_fix_to_begin_with_ends_in_a_sentence() -> None:
    class Silent(SimulatedReceiver):
        def read(self) -> Iterator[GnssRaw]:
            for raw in super().read():
                yield raw.model_copy(update={"data": b""})

    with pytest.raises(UserError, match="open sky"):
        list(times_to_first_fix(Silent(), GnssStart.COLD, 1))


def test_a_recording_is_still_the_argument_of_the_command_above() -> None:
    done = CliRunner().invoke(command_line(["kpi", "drive.mcap"]), ["kpi", "drive.mcap"])
    assert done.exit_code != 0 and "drive.mcap" in str(done.exception or done.output)
