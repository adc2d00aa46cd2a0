"""The errors of the on-board unit.

ObuError
├── UserError            something the user can mend; its text says how
│   └── ConfigError      a vehicle's file that must be changed: starting again is no use
├── BadPayload           a message on the bus that breaks the contract
├── RejectedFrame        a received V2X frame that cannot be used
├── BadRecording         a recording that cannot be read at all
├── TooManyFaults        errors that nobody foresaw, too many to go on
└── FilterDiverged       an estimator whose numbers no longer mean anything
"""

MOST_DETAIL = 200  # characters of a value found


class ObuError(Exception):
    """Base of every error that the unit raises itself."""


class UserError(ObuError):
    """Something that the user can mend: one sentence what, one what to try next."""


class ConfigError(UserError):
    """A vehicle's file that must be changed: starting again is no use.

    `cause` is what is wrong, without the name of the file and without a list of what would be right.
    """

    def __init__(self, text: str, cause: str = "") -> None:
        super().__init__(text)
        self.cause = cause or text


class BadPayload(ObuError):
    """A message on the bus that breaks the contract."""


class RejectedFrame(ObuError):
    """A received V2X frame that cannot be used; `reason` is a short key for counters, the text adds the value found.

    The value is the sender's: one that has no text, as an integer of more digits than Python writes, gives its type.
    """

    def __init__(self, reason: str, detail: object = "") -> None:
        super().__init__(f"{reason} {_short(detail)}".rstrip())
        self.reason = reason


class BadRecording(ObuError):
    """A recording that cannot be read at all."""


class TooManyFaults(ObuError):
    """Errors that nobody foresaw, too many to go on: the process ends, and is started again."""


class FilterDiverged(ObuError):
    """An estimator whose numbers no longer mean anything; `cause` is a word of `names.divergence` of core.fusion."""

    def __init__(self, text: str, cause: str = "covariance") -> None:
        super().__init__(text)
        self.cause = cause


def _short(detail: object) -> str:
    try:
        return str(detail)[:MOST_DETAIL]
    except Exception:  # noqa: BLE001 - whatever its text needs, the reason is what counts
        return type(detail).__name__
