"""Why a source of corrections delivers nothing, and when the next attempt is due."""

from shared.errors import ObuError

RETRY_S = 30.0  # for what a person mends on this machine: a file, a certificate
REFUSED_S = 300.0  # a caster locks out who repeats a wrong password


class SourceFault(ObuError):
    """The connection cannot go on; the text says what to try next.

    Parameters
    ----------
    text : str
        Without user and password.
    wait_s : float, optional
        [s] Time until the next attempt; None: by the ordinary back-off.
    refused : bool
        Whether the peer has answered, and repeating the same request is of no use.
    older : bool
        Whether the peer seems not to know NTRIP version 2.
    """

    def __init__(self, text: str, *, wait_s: float | None = None, refused: bool = False, older: bool = False) -> None:
        super().__init__(text)
        self.wait_s, self.refused, self.older = wait_s, refused, older


class ConnectionEnded(SourceFault):
    """The peer ended an open connection, or sends nothing: what it sent before may state the reason."""


def refused(text: str, wait_s: float = REFUSED_S) -> SourceFault:
    """Make the fault of a request that the peer has refused."""
    return SourceFault(text, wait_s=wait_s, refused=True)


def shown(data: bytes | str, most: int = 80) -> str:
    """Make what a peer has sent fit for a sentence: printable ASCII, and short."""
    text = data.decode("ascii", "replace") if isinstance(data, bytes) else data
    return "".join(c if " " <= c <= "~" else "?" for c in text[:most]).strip()
