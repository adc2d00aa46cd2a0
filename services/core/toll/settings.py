"""Settings of core.toll."""

from pydantic import Field

from shared.runtime.config import Section

from .delta import ErrorModel
from .location import Agreement

LOW_SPEED_M_S = 4.0  # below it a vehicle sends one CAM a second, and one that is lost is no sign of a new station ID


class ErrorSettings(Section):
    """GNSS errors at the plaza: standard deviations of a horizontal axis, and correlation times."""

    common_sd_m: float = Field(default=3.0, gt=0.0, description="error that all receivers at the plaza share")
    common_s: float = Field(default=600.0, gt=0.0, description="its correlation time")
    vehicle_sd_m: float = Field(default=0.6, gt=0.0, description="multipath of a vehicle's receiver")
    vehicle_s: float = Field(default=20.0, gt=0.0, description="its correlation time")
    unit_sd_m: float = Field(default=0.3, gt=0.0, description="multipath of the unit's receiver")
    unit_s: float = Field(default=60.0, gt=0.0, description="its correlation time")
    unit_white_sd_m: float = Field(default=0.2, gt=0.0, description="white noise of the unit's positions")
    white_sd_m: float = Field(default=0.5, gt=0.0, description="white noise of a vehicle's positions")

    @property
    def model(self) -> ErrorModel:
        """The error model of the delta position."""
        return ErrorModel(
            self.common_sd_m, self.common_s, self.vehicle_sd_m, self.vehicle_s, self.unit_sd_m, self.unit_s,
            self.unit_white_sd_m, self.white_sd_m,
        )  # fmt: skip


class DeltaSettings(Section):
    """Delta position: the common GNSS error, from the unit's own receiver."""

    window_s: float = Field(default=30.0, ge=20.0, le=60.0, description="length of the window of fixes")
    least_s: float = Field(default=3.0, gt=0.0, le=60.0, description="shortest window that is used")
    max_age_s: float = Field(default=10.0, gt=0.0, le=60.0, description="age at which a delta is not used any more")
    latency_s: float = Field(
        default=1.0, ge=0.0, le=5.0, description="time after its newest fix from which a delta is used"
    )
    corrected_prior: float = Field(
        default=0.1, ge=0.0, lt=0.5, description="share of vehicles whose receivers are corrected already"
    )
    independent_prior: float = Field(
        default=0.005, ge=0.0, lt=0.5, description="share of vehicles whose receivers err independently of the unit's"
    )

    @property
    def agreement(self) -> Agreement:
        """A priori shares for the test of each track."""
        return Agreement(corrected_prior=self.corrected_prior, independent_prior=self.independent_prior)


class TrackSettings(Section):
    """Initiation, association and deletion of tracks."""

    range_m: float = Field(default=2000.0, gt=0.0, le=5000.0, description="distance beyond which stations are rejected")
    max_tracks: int = Field(default=500, ge=1, le=5000, description="vehicles tracked at once")
    deleted_after_s: float = Field(default=5.0, gt=0.0, description="silence after which a track is deleted")
    gate_m: float = Field(
        default=8.0, gt=0.0, description="distance from the prediction, beside five standard deviations, that is used"
    )
    jumps: int = Field(
        default=3, ge=1, description="consecutive CAM outside the gate after which a new track is initiated"
    )
    clock_limit_s: float = Field(
        default=1.0,
        gt=0.0,
        description="age of a CAM on arrival above which the station's clock is taken as wrong: its times are "
        "corrected, and an authenticated CAM, whose time is signed, is rejected",
    )
    link_gate_m: float = Field(
        default=4.0, gt=0.0, description="distance from a silent track's prediction at which a new station continues it"
    )
    link_after_s: float = Field(
        default=1.5, gt=1.0, description="silence of the old station ID that confirms a pseudonym change"
    )

    def silence_ns(self, speed_m_s: float) -> int:
        """Silence of a station ID that confirms its change; at low speed two CAM must be missing, not five."""
        return round(self.link_after_s * (2.0 if abs(speed_m_s) < LOW_SPEED_M_S else 1.0) * 1e9)


class PassageSettings(Section):
    """Lane decision, passages and gates."""

    decided: float = Field(default=0.99, gt=0.5, lt=1.0, description="lane probability below which a lane is undecided")
    crossed_m: float = Field(default=1.0, ge=0.0, description="distance behind the gate line at which it is crossed")
    turned_m: float = Field(default=15.0, gt=0.0, description="distance driven back that makes a passage void")
    lost_after_s: float = Field(default=30.0, gt=0.0, description="silence after which an open passage is void")
    resume_wait_s: float = Field(
        default=3.0, ge=0.0, description="time after the start in which the ledger's open passages are awaited"
    )
    vehicle_length_m: float = Field(default=4.5, gt=0.0, description="length assumed of vehicles that state none")
    gate_lead_s: float = Field(default=8.0, gt=0.0, description="time before the crossing at which a gate is commanded")
    gate_lead_m: float = Field(default=30.0, gt=0.0, description="the same as a distance, for slow vehicles")


class Settings(Section):
    """Settings of core.toll."""

    source: str | None = Field(default=None, description="GNSS receiver of the unit; without it the first that sends")
    errors: ErrorSettings = ErrorSettings()
    delta: DeltaSettings = DeltaSettings()
    track: TrackSettings = TrackSettings()
    passage: PassageSettings = PassageSettings()
