"""`python -m broker.acl`: the broker's access list, derived from the lists of topics and of processes."""

import sys
from collections.abc import Iterator

from shared.processes import PROCESSES, ProcessRow
from shared.topics import Topic, publications, subscriptions

ANY_VEHICLE = "+"
HEAD = """\
# Who may say what to whom: printed by `python -m broker.acl`, never edited by hand.
# A process logs in with its own name. Anyone else may neither read nor write.
"""


def access_list(vehicle: str = ANY_VEHICLE) -> str:
    """Print the access list, in the format of Mosquitto's `acl_file`, for one vehicle or for any."""
    return HEAD + "".join(f"\nuser {row.name}\n" + "".join(_lines(row, vehicle)) for row in PROCESSES)


def _lines(row: ProcessRow, vehicle: str) -> Iterator[str]:
    prefix = f"obu/{vehicle}/"
    if row.observes_all:
        yield f"topic read {prefix}#\n"
    else:
        yield from (f"topic read {prefix}{topic.name}\n" for topic in subscriptions(row.name))
    yield from (f"topic write {prefix}{_own(topic, row.name)}\n" for topic in publications(row.name))


def _own(topic: Topic, process: str) -> str:
    """Name the topic; of one with a branch for each process, only the process's own."""
    return topic.name.removesuffix("+") + process if topic.per_process else topic.name


if __name__ == "__main__":
    sys.stdout.write(access_list(*sys.argv[1:2]))
