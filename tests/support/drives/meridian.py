"""A short recorded drive along a meridian, made for tests: solutions, fixes, verdicts and an outage."""

from pathlib import Path

from shared.messages.base import Message
from shared.messages.gnss import FixType, GnssFix
from shared.messages.navigation import NavigationPhase, NavigationSolution
from shared.messages.operation import Origin, OriginKind, Outage
from shared.messages.trust import TrustLevel, TrustState
from shared.recording import RecordingWriter
from tests.support.bus.envelopes import sent

BEGIN_NS = 1_700_000_000_000_000_000
SECOND = 1_000_000_000
NORTH_M_S = 10.0
DEG_PER_M = 1.0 / 111_194.9  # [deg/m] along the meridian at 48°, where its radius of curvature is 6,370.9 km
LATITUDE_DEG, LONGITUDE_DEG = 48.0, 11.0
VEHICLE_TOML = '[vehicle]\nname = "car"\n'
ZERO3 = (0.0, 0.0, 0.0)
UNIT6 = (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)


def solution(stamp_ns: int) -> NavigationSolution:
    """Give the solution of the drive at a time."""
    north_m = (stamp_ns - BEGIN_NS) * 1e-9 * NORTH_M_S
    return NavigationSolution(
        sampled_ns=stamp_ns, phase=NavigationPhase.NAVIGATING, latitude_deg=LATITUDE_DEG + north_m * DEG_PER_M,
        longitude_deg=LONGITUDE_DEG, height_ellipsoid_m=500.0, velocity_ned_m_s=(NORTH_M_S, 0.0, 0.0),
        roll_rad=0.0, pitch_rad=0.0, yaw_rad=0.0,
        angular_rate_body_rad_s=ZERO3, accelerometer_bias_m_s2=ZERO3, gyroscope_bias_rad_s=ZERO3,
        position_cov_ned_m2=UNIT6, velocity_cov_ned_m2_s2=UNIT6, attitude_cov_ned_rad2=UNIT6, stationary=False,
        gnss_age_s=0.5,
    )  # fmt: skip


def verdict(stamp_ns: int, level: TrustLevel) -> TrustState:
    """Give a verdict without monitors."""
    return TrustState(
        sampled_ns=stamp_ns, state=level, since_ns=stamp_ns, row=1, reasons=("made for a test",),
        alert_limit_horizontal_m=10.0, alert_limit_vertical_m=20.0,
    )  # fmt: skip


def messages(seconds: int) -> list[tuple[int, Message, str]]:
    """List arrival, message and producer: verdicts change every 20 s, an outage lies in the middle."""
    made: list[tuple[int, Message, str]] = []
    for tenth in range(seconds * 10):
        now_ns = BEGIN_NS + tenth * SECOND // 10
        made.append((now_ns, solution(now_ns), "core.fusion"))
        if tenth % 10 == 0:
            level = TrustLevel.SAFE if (tenth // 200) % 2 == 0 else TrustLevel.UNSAFE
            made.append((now_ns, verdict(now_ns, level), "core.trust"))
            now = solution(now_ns)
            fix = GnssFix(
                sampled_ns=now_ns, received_ns=now_ns, source="gnss0", fix_type=FixType.THREE_D,
                latitude_deg=now.latitude_deg, longitude_deg=now.longitude_deg, height_ellipsoid_m=500.0,
                velocity_ned_m_s=now.velocity_ned_m_s, satellites_used=9,
            )  # fmt: skip
            made.append((now_ns, fix, "parsers.gnss"))
    outage = Outage(what="sensors.imu", since_ns=BEGIN_NS + seconds * SECOND // 2,
                    until_ns=BEGIN_NS + seconds * SECOND // 2 + SECOND, cause="unplugged")  # fmt: skip
    made.append((outage.until_ns or 0, outage, "monitoring.health"))
    made.append((BEGIN_NS, Origin(now_ns=BEGIN_NS, kind=OriginKind.SIMULATED, name="test"), "sensors.simulator"))
    return sorted(made, key=lambda entry: entry[0])


def record(path: Path, seconds: int, *, chunk_bytes: int = 20_000, close: bool = True) -> Path:
    """Write the drive."""
    writer = RecordingWriter(path, vehicle="car", vehicle_toml=VEHICLE_TOML, chunk_bytes=chunk_bytes)
    for sequence, (now_ns, message, producer) in enumerate(messages(seconds), 1):
        writer.write(sent(message, now_ns, producer, 1, sequence))
    if close:
        writer.close()
    else:
        writer.flush()
        writer.abandon()
    return path
