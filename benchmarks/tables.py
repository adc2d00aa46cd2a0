"""Published tables, and whether the code that they describe is still that of today: `python -m benchmarks.tables`.

Each run that stores a table stores a digest of the code that it imports beside it (`results/code.json`). A page whose
digest is another one than today's says so in its first line; `make docs` renews these lines.
"""

import json
from pathlib import Path
from typing import NamedTuple

from cli.campaign import code_of
from cli.reference.wrap import wrap

ROOT = Path(__file__).resolve().parents[1]
DIGESTS = ROOT / "benchmarks" / "results" / "code.json"
OLDER = "> Older than the code that it describes: "


class Table(NamedTuple):
    """A page with measured figures: the module that measures, and the command that does it again."""

    module: str
    command: str


TABLES = {
    "benchmarks/results/attack_lab.md": Table("cli.attack_lab.attack_lab", "make attack-lab"),
    "benchmarks/results/bus.md": Table("benchmarks.bus.unit", "make bench"),
    "benchmarks/results/consistency.md": Table("benchmarks.consistency.report", "make consistency"),
    "benchmarks/results/evidence.md": Table("benchmarks.evidence", "python -m benchmarks.evidence"),
    "benchmarks/results/faults.md": Table("benchmarks.integrity.faults", "make integrity"),
    "benchmarks/results/fleet.md": Table("benchmarks.fleet.__main__", "make fleet"),
    "benchmarks/results/framing.md": Table("benchmarks.framing", "python -m benchmarks.framing"),
    "benchmarks/results/integrity.md": Table("benchmarks.integrity.report", "make integrity"),
    "benchmarks/results/mutants.md": Table("benchmarks.mutants.__main__", "make mutants"),
    "benchmarks/results/navigation.md": Table("benchmarks.navigation.report", "make drives"),
    "benchmarks/results/parsing.md": Table("benchmarks.parsing", "python -m benchmarks.parsing"),
    "benchmarks/results/replay.md": Table("benchmarks.replay", "make bench-replay"),
    "benchmarks/results/security.md": Table("benchmarks.security.__main__", "make security"),
    "benchmarks/results/set_up.md": Table("benchmarks.set_up.report", "python -m benchmarks.set_up"),
    "benchmarks/results/starts.md": Table("benchmarks.starts.report", "make starts"),
    "benchmarks/results/toll_campaign.md": Table("benchmarks.toll_campaign", "python -m benchmarks.toll_campaign"),
    "benchmarks/results/toll_honest.md": Table("benchmarks.v2x.honest", "python -m benchmarks.v2x.honest"),
    "benchmarks/results/tracking.md": Table("benchmarks.tracking", "python -m benchmarks.tracking"),
    "benchmarks/results/v2x.md": Table("benchmarks.v2x.report", "make v2x"),
    "benchmarks/results/v2x_signed.md": Table("benchmarks.v2x.signed", "make v2x"),
    "benchmarks/results/viewers.md": Table("benchmarks.viewers", "python -m benchmarks.viewers"),
    "docs/reference/drives.md": Table("benchmarks.navigation.report", "make drives"),
    "docs/reference/trust-on-drives.md": Table("benchmarks.navigation.trust", "make drives-trust"),
}


def publish(path: Path, text: str) -> None:
    """Write a table that has just been measured, with the digest of the code that measured it."""
    if path.is_relative_to(ROOT):  # a copy elsewhere is no published one
        name = path.relative_to(ROOT).as_posix()
        digests = _digests() | {name: code_of(TABLES[name].module)}
        DIGESTS.write_text(json.dumps(digests, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    path.write_text(wrap(text), encoding="utf-8")


def reprint(path: Path, text: str) -> None:
    """Write a table whose figures are those of an earlier run."""
    path.write_text(headed(path.relative_to(ROOT).as_posix(), text), encoding="utf-8")


def headed(name: str, text: str) -> str:
    """Give a table with its first line where it is older than the code."""
    body = wrap(text.split("\n\n", 1)[1] if text.startswith(OLDER) else text)
    table = TABLES[name]
    if _digests().get(name) == code_of(table.module):
        return body
    return f"{OLDER}`{table.command}` measures it again.\n\n{body}"


def _digests() -> dict[str, str]:
    return dict(json.loads(DIGESTS.read_text(encoding="utf-8"))) if DIGESTS.exists() else {}


def renew() -> list[str]:
    """Renew the first lines of all tables; give the names of those that are older than the code."""
    older = []
    for name in TABLES:
        path = ROOT / name
        text = headed(name, path.read_text(encoding="utf-8"))
        older += [name] if text.startswith(OLDER) else []
        path.write_text(text, encoding="utf-8")
    return older


if __name__ == "__main__":
    for older_than_code in renew():
        print(f"older than the code: {older_than_code}")
