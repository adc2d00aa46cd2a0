"""`make security`: the table of attacks and failures, and what came of each (13 minutes; SHORT=1: four).

Rights, routes, hosts, edited evidence, full disk and clock are tried by tests, which also run in `make test`; floods
and failures on a running unit. Ends with 1 if anything was not refused, noticed or survived.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks import tables
from shared.processes import Role
from shared.processes import running as processes_of

from .failures import BROKER, SHORT, Failure, every_failure
from .floods import Flood, every_flood
from .unit import running

ROOT = Path(__file__).resolve().parents[2]
RESULT = ROOT / "benchmarks" / "results" / "security.md"
TESTS = (
    ("connect without the secret, take over a session, write or read beyond the rights, another vehicle's topics",
     ("tests/integration/bus/test_secrets.py", "tests/unit/broker")),
    ("role x route x method", ("tests/integration/page/test_roles.py",)),
    ("a page from a foreign host or origin, rebinding, no token, behind a proxy",
     ("tests/unit/monitoring/status/web/access", "tests/unit/shared/page/access",
      "tests/integration/page/test_proxy.py")),
    ("1,100 connections to the page with 1,024 open files", ("tests/integration/page/test_limits.py",)),
    ("a byte edited, a row removed, the tail cut, a message replaced, live or simulated exchanged, another's file",
     ("tests/unit/shared/evidence", "tests/unit/shared/recording/test_proof.py",
      "tests/unit/monitoring/ledger/test_chain.py", "tests/unit/cli/test_verify_toll.py")),
    ("state disk full, each process", ("tests/integration/test_full_state_disk.py",)),
    ("clock back and forward 10 years", ("tests/integration/test_clock_jump.py",)),
    ("files that take memory", ("tests/unit/shared/test_bounded.py",)),
    ("broken messages by an allowed client, broken bytes to each parser",
     ("tests/unit/parsers/test_any_content.py", "tests/integration/bus/test_bus.py")),
)  # fmt: skip

SMOKE = (("a file that takes memory", ("tests/unit/shared/test_bounded.py",)),)
SLOW = {"tests/integration/test_full_state_disk.py", "tests/integration/test_clock_jump.py"}  # left out by `make test`


@dataclass(frozen=True)
class Row:
    """One line of the table."""

    tried: str
    outcome: str
    passed: bool


def main() -> int:
    """Try everything and write the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.security", description=__doc__)
    parser.add_argument("--short", action="store_true", help="three processes in place of all; no result is stored")
    parser.add_argument("--smoke", action="store_true", help="one row, to see that it runs; no result is stored")
    options = parser.parse_args()
    started = time.monotonic()
    rows = [_tested(tried, paths) for tried, paths in (SMOKE if options.smoke else TESTS)]
    if options.smoke:
        print(_table(rows, (time.monotonic() - started) / 60.0))
        return 0 if all(row.passed for row in rows) else 1
    names = [row.name for row in processes_of(Role.OBU, ["sensors.simulator"])]
    with tempfile.TemporaryDirectory() as folder, running(Path(folder)) as unit:
        rows += [_told(_of_flood(flood)) for flood in every_flood(unit)]
        chosen = SHORT if options.short else (*names, BROKER)
        rows += [_told(_of_failure(failure)) for failure in every_failure(unit, chosen)]
    minutes = (time.monotonic() - started) / 60.0
    text = _table(rows, minutes)
    print(text)
    if not options.short:
        tables.publish(RESULT, text)
    return 0 if all(row.passed for row in rows) else 1


def _tested(tried: str, paths: Sequence[str]) -> Row:
    chosen = "not container" if SLOW.intersection(paths) else "not slow"
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", chosen, *paths]
    done = subprocess.run(command, cwd=ROOT, env=dict(os.environ), capture_output=True, text=True, check=False)
    last = (done.stdout.strip().splitlines() or ["no output"])[-1]
    return _told(Row(tried, f"{last}: {', '.join(paths)}", done.returncode == 0))


def _of_flood(flood: Flood) -> Row:
    after = "/".join(dict.fromkeys(flood.verdicts))
    outcome = (
        f"{flood.refused}; broker at most {flood.broker_peak_mb} MB, verdict {after}, slowest answer of the page "
        f"{flood.page_slowest_s} s, {flood.log_bytes} bytes of log"
    )
    return Row(flood.name, outcome, flood.passed)


def _of_failure(failure: Failure) -> Row:
    back = "not back" if failure.back_s is None else f"back after {failure.back_s} s"
    causes = ", ".join(failure.causes) or "nothing: it was back before its deadline"
    outcome = f"{back}; named: {causes}; {failure.recordings_lost} recordings lost"
    return Row(f"{failure.how} to {failure.what}", outcome, failure.passed)


def _told(row: Row) -> Row:
    print(f"{'ok' if row.passed else 'NO':3} {row.tried}: {row.outcome}", flush=True)
    return row


def _table(rows: Sequence[Row], minutes: float) -> str:
    passed = sum(row.passed for row in rows)
    lines = [
        "# What comes of attacks and failures",
        "",
        f"`make security` of {time.strftime('%Y-%m-%d')}: {passed} of {len(rows)} as wanted, in {minutes:.0f} minutes.",
        "",
        "| tried | outcome | as wanted |",
        "| --- | --- | --- |",
        *(f"| {row.tried} | {row.outcome} | {'yes' if row.passed else '**no**'} |" for row in rows),
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
