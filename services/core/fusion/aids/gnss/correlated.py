"""Time-correlated errors of a receiver's positions and velocities, as states of a filter, and what is known of them."""

from typing import cast

from ...inertial.filter import ErrorStateFilter
from ...settings import Settings
from ...states import LAYOUT
from . import position_errors, velocity_errors
from .position_errors import GnssErrorBank, KnownGnssErrors
from .velocity_errors import GnssVelocityErrors

POSITION, VELOCITY = "gnss_error", "gnss_velocity_error"  # blocks
GNSS_ERROR = LAYOUT.place(POSITION)  # [-] error of positions over its standard deviation
GNSS_VELOCITY_ERROR = LAYOUT.place(VELOCITY)  # [m/s, NED] error of velocities
PositionErrors = GnssErrorBank | KnownGnssErrors


def position_errors_at_start(settings: Settings) -> PositionErrors:
    """Statistics of the errors of positions before the first fix: those of the settings, or unknown."""
    correlation_s, white = settings.gnss.correlation_time_s, settings.gnss.white_noise_share
    return KnownGnssErrors(correlation_s, 1.0 - white) if correlation_s else position_errors.UNKNOWN_ERRORS


def position_errors_of(navigation: ErrorStateFilter) -> PositionErrors:
    """Statistics of the errors of positions that a filter has learned."""
    return cast(PositionErrors, navigation.errors.get(POSITION, position_errors.UNKNOWN_ERRORS))


def velocity_errors_of(navigation: ErrorStateFilter) -> GnssVelocityErrors:
    """Statistics of the errors of velocities that a filter has learned."""
    return cast(GnssVelocityErrors, navigation.errors.get(VELOCITY, velocity_errors.UNKNOWN_ERRORS))


def use_position_errors(navigation: ErrorStateFilter, errors: PositionErrors) -> None:
    """Use new statistics of positions; the estimate of the error [m] is kept, and its variance is scaled."""
    before = position_errors_of(navigation)
    if errors is not before:
        navigation.use_errors(POSITION, errors)
        navigation.change_unit(GNSS_ERROR, errors.unit / before.unit)


def use_velocity_errors(navigation: ErrorStateFilter, errors: GnssVelocityErrors) -> None:
    """Use new statistics of velocities, whose error is zero where they are white, and follow positions or do not."""
    if velocity_errors_of(navigation).follows and not errors.follows:
        navigation.set_parameters(GNSS_VELOCITY_ERROR, 0.0)
    navigation.use_errors(VELOCITY, errors)
    use_position_errors(navigation, position_errors_of(navigation).following(errors.follows))
