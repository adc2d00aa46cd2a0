"""The signals at the GNSS antenna and the state of the odometer, as an attack changes them."""

from dataclasses import dataclass

from ..vehicle import AntennaState, Vector


@dataclass(frozen=True)
class SatelliteFault:
    """An error of the pseudoranges of some satellites: a number, or that of signals made for another place."""

    key: int  # number of the attack: it has the same satellites from its start to its end
    satellites: int = 0  # how many
    error_m: float = 0.0
    rate_m_s: float = 0.0  # derivative of the error
    portion: float | None = None  # in place of a number: how many of those in use, rounded up
    offset_n: Vector = (0.0, 0.0, 0.0)  # [m, NED] of the place for which their signals are made
    velocity_n: Vector = (0.0, 0.0, 0.0)  # [m/s, NED] its derivative


@dataclass(frozen=True)
class Signals:
    """GNSS signals as they are at the antenna.

    Without an attack the source is the vehicle's antenna. A spoofer replaces it: position, velocity, Doppler and
    pseudoranges are then all made from the state that its signals simulate.
    """

    source: AntennaState
    path_m: float = 0.0  # detour, which all signals have in common
    path_rate_m_s: float = 0.0
    time_offset_s: float = 0.0  # stated minus true time
    noise_rise_db: float = 0.0  # by which interference lowers every C/N0
    faults: tuple[SatelliteFault, ...] = ()
    held: bool = False  # the receiver repeats its last position and velocity
    satellites_left: int | None = None  # of one constellation and on one side; None: all
    # What the receiver states of its fix in place of its accuracy; None: the truth.
    position_accuracy_m: float | None = None  # horizontal: root sum of squares of north and east
    velocity_sd_m_s: float | None = None  # of each axis


@dataclass(frozen=True)
class Odometer:
    """What has become of the odometer."""

    factor: float = 1.0  # reported over true speed
    held: bool = False  # it repeats its last speeds
    zero_from_stop: bool = False  # it reports zero from the next standstill on
