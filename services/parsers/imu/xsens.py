"""Xsens motion trackers: MTData2 to samples.

Source: Xsens, "MT Low Level Communication Protocol Documentation", chapters 2 and 5.3.
"""

import math
from collections.abc import Sequence

from shared.messages.imu import ImuRaw, ImuSamples
from shared.messages.operation import MessageUse
from shared.protocols import xbus

from .decoder import Batch, Decoder, SampleError, Stream, check, rotate

MEASUREMENT = "Xbus MTData2"
TICK_NS = 100_000  # resolution of the field SampleTimeFine
TICK_WRAP = 1 << 32
COUNTER_WRAP = 1 << 16
MAX_LOST_PACKETS = 1000  # a larger gap of the packet counter is a restart of the tracker
MAX_FIELD = 1000.0  # plausibility limit, in units of the Earth's field
CELSIUS_K = 273.15
SLOW_QUANTITIES = ((xbus.TEMPERATURE, CELSIUS_K), (xbus.BARO_PRESSURE, 1e6))  # greatest value [°C, Pa]
INERTIAL = frozenset((xbus.ACCELERATION, xbus.RATE_OF_TURN, xbus.DELTA_V, xbus.DELTA_Q))


class Tracker(Decoder):
    """A tracker that sends MTData2.

    `rejects` counts the rejects of the reader, and `packet_gap` (lost measurements), `counter_restart`,
    `no_sample_time`, `no_acceleration`, `no_rate_of_turn`, `no_acceleration_and_rate_of_turn`, `repeated_sample`,
    `not_finite`, `out_of_range`.
    """

    def __init__(self, stream: Stream) -> None:
        super().__init__(stream)
        self._rejects = stream.rejects
        self._reader = xbus.XbusReader(stream.rejects)
        self._counter: int | None = None
        self._ticks: int | None = None  # unwrapped
        self._newest: dict[int, tuple[float, ...]] = {}  # newest values since the last message, by data identifier

    def take(self, raw: ImuRaw) -> ImuSamples | None:
        """Process the next bytes; return one message with all completed samples, or None."""
        batch = Batch()
        for message in self._reader.feed(raw.data):
            if message.mid == xbus.MTDATA2:
                with self.faults.decoding(raw.received_ns):
                    self._take_measurement(batch, message.payload)
            else:
                use = MessageUse.UNUSED if message.mid in xbus.KNOWN_MESSAGES else MessageUse.UNKNOWN
                self.count(f"Xbus {xbus.KNOWN_MESSAGES.get(message.mid, f'0x{message.mid:02X}')}", use)
        return self._message(batch, raw.received_ns) if batch.device_ns else None

    def _take_measurement(self, batch: Batch, payload: bytes) -> None:
        try:
            self._add(batch, xbus.decode_mtdata2(payload, self._rejects))
        except SampleError as fault:
            self.count(MEASUREMENT, MessageUse.USED, fault)
        else:
            self.count(MEASUREMENT, MessageUse.USED)

    def _add(self, batch: Batch, values: dict[int, tuple[float, ...]]) -> None:
        self._count_gap(values)
        self._newest.update(values)
        if not values.keys() & INERTIAL:
            if self._ticks is None:
                raise SampleError("no_acceleration_and_rate_of_turn")
            return  # slow quantities may be sent in messages of their own
        batch.saturated |= bool(int(values.get(xbus.STATUS_WORD, (0,))[0]) & xbus.CLIPPED)
        if xbus.SAMPLE_TIME_FINE not in values:
            raise SampleError("no_sample_time")
        interval_s, ticks = self._interval_s(int(values[xbus.SAMPLE_TIME_FINE][0]))
        if interval_s == 0.0:
            raise SampleError("repeated_sample")
        self._ticks = ticks
        force, rate = inertial_data(values, interval_s)
        self.add(batch, ticks * TICK_NS, force, rate)

    def _interval_s(self, ticks: int) -> tuple[float | None, int]:
        """Time since the last sample [s] (None for the first, or after a restart), and the unwrapped ticks."""
        if self._ticks is None:
            return None, ticks
        step = (ticks - self._ticks) % TICK_WRAP
        if step < TICK_WRAP // 2:
            return step * TICK_NS * 1e-9, self._ticks + step
        return None, ticks

    def _count_gap(self, values: dict[int, tuple[float, ...]]) -> None:
        if xbus.PACKET_COUNTER not in values:
            return
        counter = int(values[xbus.PACKET_COUNTER][0])
        if self._counter is not None and (lost := (counter - self._counter - 1) % COUNTER_WRAP):
            restarted = lost > MAX_LOST_PACKETS
            self._rejects["counter_restart" if restarted else "packet_gap"] += 1 if restarted else lost
        self._counter = counter

    def _message(self, batch: Batch, received_ns: int) -> ImuSamples:
        newest, self._newest = self._newest, {}
        celsius, pressure_pa = (self._slow(newest.get(kind), most) for kind, most in SLOW_QUANTITIES)
        field_sensor = newest.get(xbus.MAGNETIC_FIELD)
        if field_sensor is not None:
            try:
                check(field_sensor, MAX_FIELD)
            except SampleError as fault:
                self._rejects[str(fault)] += 1
                field_sensor = None
        return self.samples(
            batch,
            received_ns,
            temperature_k=None if celsius is None else celsius + CELSIUS_K,
            pressure_pa=pressure_pa or None,  # 0: not measured yet
            magnetic_field_body=rotate(self.stream.body_from_sensor, field_sensor) if field_sensor else None,
        )

    def _slow(self, values: Sequence[float] | None, most: float) -> float | None:
        """A slow quantity of one number; one that cannot be is counted, and costs itself only."""
        if values is None:
            return None
        try:
            check(values, most)
        except SampleError as fault:
            self._rejects[str(fault)] += 1
            return None
        return float(values[0])


def inertial_data(values: dict[int, tuple[float, ...]], interval_s: float | None) -> tuple[Sequence[float], ...]:
    """Specific force and angular rate of a measurement, in sensor axes.

    Parameters
    ----------
    values : dict
        Data identifier -> numbers. Increments (delta-v, delta-q) are used if acceleration or rate is missing.
    interval_s : float or None
        [s] Integration interval of the increments: the time since the previous measurement.

    Returns
    -------
    tuple
        Specific force [m/s², sensor] and angular rate [rad/s, sensor].

    Raises
    ------
    SampleError
        One of the two is missing.

    Notes
    -----
    With the increment of attitude as the unit quaternion q = (cos(a/2), n sin(a/2))::

        f = Δv / Δt        ω = n a / Δt
    """
    force, rate = values.get(xbus.ACCELERATION), values.get(xbus.RATE_OF_TURN)
    if force is None and interval_s and xbus.DELTA_V in values:
        force = tuple(increment / interval_s for increment in values[xbus.DELTA_V])
    if rate is None and interval_s and xbus.DELTA_Q in values:
        w, *axis = values[xbus.DELTA_Q]
        sine = math.hypot(*axis)
        angle = 2 * math.atan2(math.copysign(sine, w), abs(w))
        rate = tuple(part * (angle / sine if sine else 2.0) / interval_s for part in axis)
    missing = [name for name, value in (("acceleration", force), ("rate_of_turn", rate)) if value is None]
    if force is None or rate is None:
        raise SampleError(f"no_{'_and_'.join(missing)}")
    return force, rate
