"""Settings of the V2X parser."""

from pathlib import Path

from pydantic import Field, ValidationInfo, model_validator

from shared.runtime.config import Section, vehicle_in

SIMULATED_TRUST = Path("deploy/trust")  # with the root of the simulated traffic, which is a test root
TRAFFIC = "sensors.traffic"


class SecuritySettings(Section):
    """Verification of signed CAM."""

    trust_folder: Path | None = Field(
        default=None,
        description="folder with the certificates and lists that are trusted; test roots lie in its sub-folder `test`. "
        "If not given, nobody is authenticated; beside sensors.traffic it is deploy/trust, with the simulation's root",
    )
    countries: tuple[int, ...] = Field(
        default=(),
        max_length=20,
        description="numbers (ISO 3166-1) of the country, and of unions of countries, in which this unit is: "
        "certificates that are valid in named countries are judged by them",
    )
    list_grace_h: float = Field(
        default=24.0,
        ge=0.0,
        le=2160.0,
        description="time after which trust lists whose next one is overdue count no more: nobody is authenticated "
        "then by what they hold",
    )
    max_age_s: float = Field(
        default=2.0,
        gt=0.0,
        le=5.0,
        description="largest difference between the time of a signature and its reception; others are rejected",
    )


class Settings(Section):
    """Settings of the V2X parser."""

    max_age_s: float = Field(default=5.0, ge=0.0, le=32.0, description="largest age of a CAM; older ones are rejected")
    max_future_s: float = Field(
        default=2.0,
        ge=0.0,
        le=32.0,
        description="CAM whose generation time is further ahead of this unit's are rejected",
    )
    max_header_difference_s: float = Field(
        default=1.0,
        ge=0.0,
        le=32.0,
        description="frames whose GeoNetworking time, or whose time of signature, differs by more from the generation "
        "time of their CAM are rejected: a CAM repeated after 65.536 s has the generation time of a new one, and not "
        "its header",
    )
    max_distance_m: float = Field(
        default=10_000.0, gt=0.0, description="CAM of stations further from this unit's GNSS position are rejected"
    )
    security: SecuritySettings = SecuritySettings()
    simulated: bool = Field(
        default=False,
        description="the unit runs beside sensors.traffic, where test roots are trusted; follows from the vehicle's "
        "file, and cannot be set to true without that section",
    )

    @model_validator(mode="before")
    @classmethod
    def _beside_traffic(cls, given: object, info: ValidationInfo) -> object:
        """Test roots are trusted beside simulated traffic, and nowhere else."""
        vehicle = vehicle_in(info.context)
        if not isinstance(given, dict) or vehicle is None:
            return given
        is_simulated = TRAFFIC in vehicle.tables
        if given.get("simulated") and not is_simulated:
            raise ValueError(f"simulated = true needs [{TRAFFIC}]: test roots are refused on the road")
        security = given.get("security", {})
        if is_simulated and isinstance(security, dict):
            security = {"trust_folder": SIMULATED_TRUST, **security}
        return {"simulated": is_simulated, **given, "security": security}
