"""The PKI of simulated traffic: a test root, whose key everybody can compute, and the tickets of its vehicles.

Run as a program, this writes the files of the test root:
`python -m shared.v2x.security.issuing.simulated deploy/trust/test`.
"""

import sys
from functools import cache
from pathlib import Path

from .signing import Holder, authority_tbs, issue, key_of, revocation_list, root_tbs, ticket_tbs

ROOT_NAME, AUTHORITY_NAME = "OBU simulation: test root", "OBU simulation: test AA"
YEARS, UNTIL_S = 100, 3_000_000_000  # from 2004 on; [s] ITS time in 2099
TICKET_HOURS = 168
HOUR_S = 3600


@cache
def root() -> Holder:
    """The test root."""
    return issue(key_of(b"OBU simulation root", "ecdsaBrainpoolP384r1"), root_tbs(ROOT_NAME, 0, YEARS))


@cache
def authority() -> Holder:
    """The authority that issues the vehicles' tickets."""
    return issue(key_of(b"OBU simulation AA"), authority_tbs(AUTHORITY_NAME, 0, YEARS), root())


def ticket(seed: bytes, now_s: int) -> Holder:
    """Ticket that is valid at an ITS time [s]."""
    return issue(key_of(b"OBU simulation AT" + seed), ticket_tbs(now_s - HOUR_S, TICKET_HOURS), authority())


def files() -> dict[str, bytes]:
    """Content of the folder of the test root."""
    return {
        "simulation_root.oer": root().certificate.encoded,
        "simulation_aa.oer": authority().certificate.encoded,
        "simulation_crl.oer": revocation_list(root(), 0, UNTIL_S),
    }


def main(folder: str) -> None:
    """Write the files."""
    for name, content in files().items():
        (Path(folder) / name).write_bytes(content)


if __name__ == "__main__":
    main(sys.argv[1])
