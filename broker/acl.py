"""`python -m broker.acl`: the broker's access list, derived from the lists of topics and of processes."""

import argparse
import sys
from collections.abc import Iterator, Mapping, Sequence

from shared.processes import PROCESSES, Kind, ProcessRow
from shared.programs import ROLES
from shared.runtime.credentials import CHECK, OBSERVERS
from shared.topics import BROKER_LOG, BY_NAME, REPLAY, Topic, measurements, publications, readable

ANY_VEHICLE = "+"


HEAD = """\
# Access list: rights to read and write topics. Printed by `python -m broker.acl`; do not edit.
# The user name of a process is its own name. Programs that listen are one of the observers, the health check of the
# broker's container is `broker.check`, and the replay of a recording `replay`.
"""
NOBODY_ELSE = "# Other users may neither read nor write.\n"


def access_list(
    vehicle: str = ANY_VEHICLE,
    *,
    rows: Sequence[ProcessRow] = PROCESSES,
    readers: Sequence[str] = (),
    programs: Mapping[str, str] | None = None,
    nameless_read: bool = False,
    replay: bool = False,
    replayed: bool = True,
) -> str:
    """Print the access list in the format of Mosquitto's `acl_file`.

    It holds for one vehicle or for any, for the processes `rows`, further users that only read, and `programs`: names
    with their role of `ROLES`; clients without a
    name may read everything or, ordinarily, nothing. On the broker of a replay `sensors.replay` publishes in place of
    every process; `obu replay --broker` publishes in place of the sensors where `replayed` allows it.
    """
    prefix = f"obu/{vehicle}/"
    everything = f"topic read {prefix}#\n"
    nameless = f"\n# Clients without a name may read.\n{everything}" if nameless_read else NOBODY_ELSE
    observers = "".join(f"\nuser {name}\n{everything}" for name in (*OBSERVERS, *readers))
    observers += "".join(f"\nuser {name}\n{_program(role, prefix)}" for name, role in (programs or {}).items())
    users = (
        f"\nuser {row.name}\n" + ("topic write obu/#\n" if replay and row.kind is Kind.REPLAY else "")
        + "".join(_lines(row, prefix)) for row in rows
    )  # fmt: skip
    return f"{HEAD}{nameless}{observers}\n{_check(prefix)}{_replay(prefix) if replayed else ''}{''.join(users)}"


def _program(role: str, prefix: str) -> str:
    rights = ROLES[role]
    reads = (f"topic read {prefix}{name}\n" for name in rights.reads or ("#",))
    return "".join((*reads, *(f"topic write {prefix}{name}\n" for name in rights.writes)))


def _check(prefix: str) -> str:
    return f"user {CHECK}\ntopic read {prefix}health/+\n"


def _replay(prefix: str) -> str:
    origin = BY_NAME["origin/state"]
    writes = (f"topic write {prefix}{topic.name}\n" for topic in (*measurements(), origin))
    return f"\nuser {REPLAY}\ntopic read {prefix}{origin.name}\n{''.join(writes)}"


def _lines(row: ProcessRow, prefix: str) -> Iterator[str]:
    if row.observes_all:
        yield f"topic read {prefix}#\n"
    else:
        yield from (f"topic read {prefix}{topic.name}\n" for topic in readable(row.name))
    yield from (f"topic write {prefix}{_own(topic, row.name)}\n" for topic in publications(row.name))
    if row.name == "monitoring.health":
        yield f"topic read {BROKER_LOG}\n"


def _own(topic: Topic, process: str) -> str:
    """Name the topic; of one with a branch for each process, only the process's own."""
    return topic.name.removesuffix("+") + process if topic.per_process else topic.name


def main() -> None:
    """Print the access list."""
    parser = argparse.ArgumentParser(prog="python -m broker.acl", description="Print the broker's access list.")
    parser.add_argument("--vehicle", default=ANY_VEHICLE, help="name of the only vehicle (default: any)")
    parser.add_argument("--nameless-read", action="store_true", help="clients without a name may read everything")
    options = parser.parse_args()
    sys.stdout.write(access_list(options.vehicle, nameless_read=options.nameless_read))


if __name__ == "__main__":
    main()
