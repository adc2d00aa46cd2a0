"""Brings GNSS and odometer speeds together: samples every 10 s, aligned pairs, and the statistic of the fast test.

A sample of the tachograph's tests is the first GNSS speed at or after a multiple of 10 s with the odometer's speed
interpolated to its stamp. The paper takes the first odometer speed at or after that time, which adds the
synchronisation error ΔT · dS/dt.
"""

from collections import Counter, deque
from math import isfinite, radians

from . import fast
from .aligned import SECOND_NS, SLOPE_NS, OdometerTrack
from .calibration import Calibration, CalibrationEstimator
from .held import USUAL_HOLD_S, HeldSpeed
from .settings import Settings
from .tachograph import KM_H, PERIOD_S, SAMPLES, DistanceRule, MotionSensorRule, SpeedWindow, WindowMode

PERIOD_NS = int(PERIOD_S * SECOND_NS)
SLOPE_S = SLOPE_NS / SECOND_NS
INCONSPICUOUS = 1.0  # expected value of the fast statistic: a window below it shows no sign of a fault
Epoch = tuple[int, float, float]  # stamp, speed and standard deviation of GNSS


class SpeedComparison:
    """What the tests need: windows of samples every 10 s, aligned pairs, the calibration, and the rules' counters.

    Stamps are on one time line; each source's stamps increase. A speed that is implausible or not newer than the one
    before is rejected and counted in `rejected`. `calibration.frozen` stops learning.
    """

    def __init__(self, settings: Settings | None = None, *, start: Calibration | None = None) -> None:
        self.settings = s = settings or Settings()
        self.rejected: Counter[str] = Counter()
        self.raw = SpeedWindow(s.window, still_m_s=s.still_m_s)
        self.compensated = SpeedWindow(WindowMode.MOVING, still_m_s=s.still_m_s)
        self.calibration = CalibrationEstimator(delay_limits_s=s.delay_limits_s, start=start)
        self.held = HeldSpeed()
        self.distance = DistanceRule(gap_s=s.pairing_s)
        self.motion_sensor = MotionSensorRule(moving_m_s=s.motion_sensor_moving_m_s, gap_s=s.pairing_s)
        self.track = OdometerTrack(gap_s=s.pairing_s)
        self._pending: deque[Epoch] = deque(maxlen=256)  # not reached by the odometer yet
        self._window: deque[Epoch] = deque(maxlen=256)  # of the fast test
        self._learnable: deque[Epoch] = deque(maxlen=256)  # not reached with the largest delay yet
        self.gnss_ns: int | None = None  # newest epoch
        self.speed_ns: int | None = None  # newest epoch with a speed that is measured
        self._slot: int | None = None
        self._candidate: tuple[int, float] | None = None  # GNSS sample of the slot
        self._sampled = False
        self._compensated_slot: int | None = None
        self.fast_statistic: tuple[int, float] | None = None  # of the fast test, with the stamp of its window's end
        self.inconspicuous_ns: int | None = None  # start of the newest window without a sign of a fault

    def gnss(self, time_ns: int, speed_m_s: float | None, sd_m_s: float | None = None) -> bool:
        """Use a GNSS speed over ground; None when the receiver has no fix, whatever number it reports.

        Returns
        -------
        bool
            Whether it is a measured speed: neither rejected, nor missing, nor the last one repeated.
        """
        if not self._acceptable("gnss", time_ns, self.gnss_ns, speed_m_s, self.settings.largest_gnss_m_s):
            return False
        if sd_m_s is not None and not (isfinite(sd_m_s) and sd_m_s > 0.0):
            self.rejected["gnss: accuracy is not a positive number"] += 1
            return False
        self.advance(time_ns)
        self.gnss_ns = time_ns
        self.held.gnss(time_ns, speed_m_s)
        held_since_ns = self.held.since_ns
        if held_since_ns is not None and self.held.held_s <= USUAL_HOLD_S:
            speed_m_s = None
            self._forget_held(held_since_ns)
        self.motion_sensor.update(time_ns, speed_m_s, self.track.newest(time_ns))
        if speed_m_s is None:
            return False
        self.speed_ns = time_ns
        sd = max(self.settings.gnss_sd_floor_m_s, sd_m_s if sd_m_s is not None else self.settings.gnss_sd_m_s)
        if self._candidate is None and not self._sampled and time_ns % PERIOD_NS <= self.settings.pairing_s * SECOND_NS:
            self._candidate = (time_ns, speed_m_s)
        self._pending.append((time_ns, speed_m_s, sd))
        self._pair()
        return True

    def odometer(self, time_ns: int, speed_m_s: float | None, resolution_m_s: float | None = None) -> bool:
        """Use an odometer speed as the vehicle reports it, with its step (None: 1 km/h, OBD-II PID 0x0D).

        Returns
        -------
        bool
            Whether it is used.
        """
        limit = self.settings.largest_odometer_m_s
        if speed_m_s is None or not self._acceptable("odometer", time_ns, self.track.newest_ns, speed_m_s, limit):
            return False
        resolution = 1.0 * KM_H if resolution_m_s is None else resolution_m_s
        if not (isfinite(resolution) and 0.0 <= resolution < 3.0):
            self.rejected["odometer: resolution is not within 0 to 3 m/s"] += 1
            return False
        self.advance(time_ns)
        self.track.add(time_ns, speed_m_s, resolution)
        self.held.odometer(speed_m_s, resolution)
        self.distance.odometer(time_ns, speed_m_s)
        self._pair()
        return True

    def position(self, time_ns: int, latitude_deg: float, longitude_deg: float) -> None:
        """Use a GNSS position with a valid fix, for the distance rule."""
        if not (abs(latitude_deg) <= 90.0 and abs(longitude_deg) <= 180.0):
            self.rejected["gnss: position is outside the Earth's coordinates"] += 1
            return
        self.distance.position(time_ns, radians(latitude_deg), radians(longitude_deg))

    def _acceptable(self, source: str, time_ns: int, last_ns: int | None, speed: float | None, limit: float) -> bool:
        reason = None
        if last_ns is not None and time_ns <= last_ns:
            reason = "stamp is not after the one before"
        elif speed is not None and not isfinite(speed):
            reason = "speed is not a number"
        elif speed is not None and not 0.0 <= speed <= limit:
            reason = f"speed is not within 0 to {limit:.0f} m/s"
        if reason is not None:
            self.rejected[f"{source}: {reason}"] += 1
        return reason is None

    def advance(self, time_ns: int) -> None:
        """Close the sample times that have passed without both speeds."""
        slot, grace_ns = time_ns // PERIOD_NS, 2 * int(self.settings.pairing_s * SECOND_NS)
        if self._slot is None:
            self._slot = slot
        self._slot = max(self._slot, slot - SAMPLES)  # after a long silence one window of missing samples is enough
        while self._slot < slot:
            self._close()
            self._slot, self._sampled = self._slot + 1, False
        if time_ns > self._slot * PERIOD_NS + grace_ns:
            self._close()

    def _close(self) -> None:
        if self._slot is not None and not self._sampled:
            self.raw.add(self._slot * PERIOD_NS, None, None)
        self._candidate, self._sampled = None, True

    def _forget_held(self, since_ns: int) -> None:
        """Drop what has been queued of a speed before it was recognised as held."""
        for queue in (self._pending, self._window, self._learnable):
            while queue and queue[-1][0] >= since_ns:
                queue.pop()
        if self._candidate is not None and self._candidate[0] >= since_ns:
            self._candidate = None
        self.fast_statistic = None

    def _pair(self) -> None:
        """Complete the sample of this sample time, and every aligned pair that the odometer's samples reach."""
        newest_ns = self.track.newest_ns
        if self._candidate is not None and newest_ns is not None and newest_ns >= self._candidate[0]:
            time_ns, speed = self._candidate
            self.raw.add(time_ns, speed, self.track.at(time_ns))
            self._candidate, self._sampled = None, True
        known = self.calibration.calibration
        while self._pending and self.track.reaches(self._pending[0][0], known.delay_s + SLOPE_S):
            epoch = self._pending.popleft()
            self._window.append(epoch)
            self._learnable.append(epoch)
            self._test(epoch, known)
        longest_s = max(float(self.calibration.delays_s[-1]), known.delay_s + SLOPE_S)
        while self._learnable and self.track.reaches(self._learnable[0][0], longest_s):
            self._learn(self._learnable.popleft())

    def _test(self, epoch: Epoch, known: Calibration) -> None:
        time_ns, speed, sd = epoch
        pair = self.track.pair(time_ns, known.delay_s, (speed, sd))
        if pair is None:
            return
        self._test_fast(known)
        if time_ns // PERIOD_NS != self._compensated_slot:
            self._compensated_slot = time_ns // PERIOD_NS
            self.compensated.add(time_ns, speed, known.scale * pair.odometer)

    def _learn(self, epoch: Epoch) -> None:
        time_ns, speed, sd = epoch
        series = self.track.series(time_ns, self.calibration.delays_s)
        pair = self.track.pair(time_ns, self.calibration.calibration.delay_s, (speed, sd))
        if series is not None and pair is not None:
            self.calibration.update(pair, series)

    def _test_fast(self, calibration: Calibration) -> None:
        newest_ns = self._window[-1][0]
        while newest_ns - self._window[0][0] > fast.WINDOW_S * SECOND_NS:
            self._window.popleft()
        aligned = [self.track.pair(t, calibration.delay_s, (speed, sd)) for t, speed, sd in self._window]
        pairs = [pair for pair in aligned if pair is not None]
        if len(pairs) < fast.MIN_SAMPLES:
            return
        odometer = sum(pair.odometer for pair in pairs) / len(pairs)
        slope = sum(pair.slope for pair in pairs) / len(pairs)
        statistic = fast.fast_statistic(
            pairs,
            scale=calibration.scale,
            calibration_variance=self.calibration.speed_variance(odometer, slope),
            correlation_s=self.settings.gnss_correlation_s,
            dead_zone_m_s=self.settings.dead_zone_m_s,
        )
        if statistic <= INCONSPICUOUS or self.inconspicuous_ns is None:
            self.inconspicuous_ns = pairs[0].time_ns
        self.fast_statistic = (newest_ns, statistic)
