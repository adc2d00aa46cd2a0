"""The attacks on a simulated vehicle as JSON: what is possible, what is active, and whether the verdict is right."""

from shared.attacks import ATTACKS, Parameter
from shared.messages.simulation import SimulationState
from shared.messages.trust import TrustState

from ..state import State
from .models.simulation import Catalogue, ParameterShown, SimulationShown


def catalogue() -> Catalogue:
    """List every attack with its parameters, their defaults and limits."""
    return {
        "attacks": [
            {
                "name": row.name,
                "label": row.name.replace("_", " "),
                "purpose": row.purpose,
                "parameters": [_parameter(parameter) for parameter in row.parameters],
            }
            for row in ATTACKS
        ]
    }


def simulation(state: State, now_ns: int) -> SimulationShown | None:
    """Show the attacks of the drive and the comparison with the truth; None unless the data are simulated."""
    if not state.simulated(now_ns):
        return None
    message = state.newest(SimulationState, "simulation/state", now_ns)
    trust = state.newest(TrustState, "trust/state", now_ns, live=True)
    found = state.truth_check.newest
    return {
        "request_id": message.request_id if message else None,
        "refused": message.refused or None if message else None,
        "attacks": [run.model_dump(mode="json") for run in message.attacks] if message else [],
        "verdict": trust.state if trust else None,
        "error_horizontal_m": None if found is None else round(found.horizontal_m, 2),
        "error_vertical_m": None if found is None else round(found.vertical_m, 2),
        "above": None if found is None else found.above,
        "seconds": {
            level: {"within": round(within, 1), "above": round(above, 1)}
            for level, (within, above) in state.truth_check.seconds.items()
        },
    }


def _parameter(one: Parameter) -> ParameterShown:
    return {
        "name": one.name,
        "default": one.default,
        "least": one.least,
        "greatest": one.greatest,
        "unit": one.unit,
        "purpose": one.purpose,
    }
