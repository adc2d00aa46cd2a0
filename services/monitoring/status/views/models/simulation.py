"""Attacks on a simulated vehicle."""

from typing_extensions import TypedDict

from shared.messages.trust import TrustLevel
from shared.page.answers import Object, answer


@answer()
class ParameterShown(TypedDict):
    """A number of an attack."""

    name: str
    default: float
    least: float
    greatest: float
    unit: str
    purpose: str


@answer()
class AttackShown(TypedDict):
    """A possible attack."""

    name: str
    label: str
    purpose: str
    parameters: list[ParameterShown]


@answer()
class SecondsShown(TypedDict):
    """How long the error was within and above the alert limits [s]."""

    within: float
    above: float


@answer()
class SimulationShown(TypedDict):
    """The attacks of the drive, and the comparison of the verdict with the truth."""

    request_id: str | None
    refused: str | None
    """why the newest command was refused"""
    attacks: list[Object]
    verdict: TrustLevel | None
    error_horizontal_m: float | None
    error_vertical_m: float | None
    above: bool | None
    """an error is above its alert limit"""
    seconds: dict[TrustLevel, SecondsShown]


@answer()
class Catalogue(TypedDict):
    """Every attack that is possible."""

    attacks: list[AttackShown]


@answer()
class Simulation(Catalogue):
    """Attacks of a simulated vehicle."""

    simulation: SimulationShown | None
