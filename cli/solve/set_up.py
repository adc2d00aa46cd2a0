"""Findings of the checks of the set-up, as sentences."""

from shared.messages.navigation import SetUpState, SetUpVerdict


def findings(state: SetUpState | None) -> list[str]:
    """One sentence a finding, with its evidence and the setting that corrects it."""
    return [
        f"Installation check: {check.sentence}." + (f" Setting: {check.setting}" if check.setting else "")
        for check in (state.checks if state else ())
        if check.verdict is SetUpVerdict.CONTRADICTS
    ]
