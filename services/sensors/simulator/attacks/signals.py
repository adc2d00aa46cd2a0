"""The signals at the GNSS antenna and the state of the odometer: all that an attack changes."""

from dataclasses import dataclass

from ..vehicle import AntennaState


@dataclass(frozen=True)
class SatelliteFault:
    """An error of the pseudoranges of some satellites."""

    key: int  # number of the attack: it has the same satellites from its start to its end
    satellites: int  # how many
    error_m: float
    rate_m_s: float  # derivative of the error


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


@dataclass(frozen=True)
class Odometer:
    """What has become of the odometer."""

    factor: float = 1.0  # reported over true speed
    held: bool = False  # it repeats its last speeds
