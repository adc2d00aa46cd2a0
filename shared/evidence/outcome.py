"""What a check of signatures can find; the values are exit codes of `obu verify` and `obu verify-toll`."""

from enum import IntEnum


class Outcome(IntEnum):
    """Result of a check, as an exit code; 1 and 2 are left to other failures of a command."""

    VERIFIED = 0
    UNSIGNED = 3
    CUT = 4  # proven up to a time, and not finished, as after a power cut
    EDITED = 5
    FOREIGN = 6  # signed by a key that is not among those accepted
    REWRITTEN = 7  # the signed content in another form, or a copy that says what it was made of


EXIT_DIFFERENT = 1  # exit code: a process that is repeated publishes something else
OTHER_RELEASE = 8  # exit code: only the release that has made the recording can repeat it
GRAVITY = (Outcome.EDITED, Outcome.FOREIGN, Outcome.REWRITTEN, Outcome.CUT, Outcome.UNSIGNED, Outcome.VERIFIED)


def gravest(outcomes: "list[Outcome]") -> Outcome:
    """Give the outcome of several files: the gravest; verified if there is none."""
    return min(outcomes, key=GRAVITY.index, default=Outcome.VERIFIED)
