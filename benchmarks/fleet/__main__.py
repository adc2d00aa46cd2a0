"""Simulated fleets against a real centre: `python -m benchmarks.fleet`, some 9 minutes.

Three runs, each against a centre of its own: a fleet with kills of every part; a backlog; and many connections.
Processor time is that of broker, ingest and database with their children, of the kernel's counters, once all vehicles
are connected. With `--short` they take two minutes, and nothing is stored.
"""

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from benchmarks import tables
from cli.fleet.simulate import lines
from fleet.centre import Centre
from fleet.simulate.campaign import Campaign, Outcome, Plan
from fleet.simulate.processes import INGEST, NATS, POSTGRES
from fleet.simulate.traffic import Disturbance
from tests.support.fleet.running_centre import running_centre

RESULT = Path(__file__).parents[1] / "results" / "fleet.md"
LOAD_PARTS = NATS, INGEST, POSTGRES
DISTURBED = Disturbance(repeat=0.2, reorder=True)
PLANS = {
    "kills": Plan(1150, 300.0, 100, backlog_s=600, kills=24, disturbance=DISTURBED),
    "backlog": Plan(1000, 60.0, backlog_s=600),
    "load": Plan(10_000, 60.0),
}
SHORT = {
    "kills": Plan(60, 40.0, 12, backlog_s=120, kills=8, disturbance=DISTURBED, retry_s=2.0),
    "backlog": Plan(100, 10.0, backlog_s=300),
    "load": Plan(500, 15.0),
}
SMOKE = {"backlog": Plan(5, 3.0, backlog_s=5)}
TITLE = """# A fleet and its centre

By `make fleet`: vehicles of `obu fleet simulate`, each with its own keys, certificate and connection, report ten
positions in ten seconds to a centre that `obu centre up` runs on the same machine ({cores} cores, load average before
{load:.1f}; the vehicles' own work is on them as well).

"""
KILLS = """## Every part killed

{plan.vehicles} vehicles, {plan.durable} of them with the outbox of a unit on the disk in processes that are
killed as well;
{backlog} minutes of backlog, {repeat:.0f} % of the batches sent twice, a fifth held back for up to 3 s.

"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run, print and store; return 1 if a report is lost or double, or a goal is missed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.fleet", description=__doc__)
    parser.add_argument("--short", action="store_true", help="small fleets, in two minutes; stores no result")
    parser.add_argument("--smoke", action="store_true", help="five vehicles, to see that it runs; stores no result")
    parser.add_argument("--only", choices=list(PLANS), help="one of the runs; stores no result")
    options = parser.parse_args(arguments)
    plans = SMOKE if options.smoke else SHORT if options.short else PLANS
    load = os.getloadavg()[0]
    outcomes = {name: _run(plan) for name, plan in plans.items() if options.only in (None, name)}
    whole = all(outcome.verdict.holds and not outcome.waiting for outcome in outcomes.values())
    if options.short or options.smoke or options.only:
        return 0 if whole else 1
    goals = _goals(outcomes)
    text = TITLE.format(cores=os.cpu_count(), load=load) + _table(goals) + "\n" + _details(outcomes)
    tables.publish(RESULT, text)
    print(text)
    return 0 if whole and all(good for *_, good in goals) else 1


def _run(plan: Plan) -> Outcome:
    with running_centre() as folder:
        outcome = Campaign(Centre(folder), plan, lambda text: print(text, flush=True)).run()
    print("\n".join(lines(outcome)), flush=True)
    return outcome


Goal = tuple[str, str, str, bool]


def _goals(outcomes: dict[str, Outcome]) -> list[Goal]:
    kills, backlog, load = outcomes["kills"], outcomes["backlog"], outcomes["load"]
    verdict = kills.verdict

    def least(name: str, value: float, goal: float, form: Callable[[float], str]) -> Goal:
        return name, form(value), f"at most {form(goal)}", value <= goal

    used_us = sum(load.us_a_report[part] for part in LOAD_PARTS)
    cores = sum(load.cpu_s[part] for part in LOAD_PARTS) / load.measured_s
    drained_s = backlog.drained_s if backlog.drained_s is not None else float("inf")
    return [
        ("reports made, with kills", f"{verdict.made:,}", "at least 1,000,000", verdict.made >= 1_000_000),
        ("kills", str(kills.kills.total()), "at least 20", kills.kills.total() >= 20),
        ("reports lost, double, foreign", f"{verdict.lost}, {verdict.double}, {verdict.foreign}", "0, 0, 0",
         verdict.holds and not kills.waiting),
        least("processor time a report", used_us, 60, lambda value: f"{value:.1f} us"),
        least(f"processor time, {load.plan.vehicles:,} vehicles", cores, 0.6, lambda value: f"{value:.2f} cores"),
        least(f"NATS, {load.plan.vehicles:,} connections", load.memory_mb[NATS], 700, lambda value: f"{value:.0f} MB"),
        least("MQTT sent, a vehicle and hour", load.bytes_hour[0] / 1000, 120, lambda value: f"{value:.0f} kB"),
        least(f"backlog of 10 minutes, {backlog.plan.vehicles:,} vehicles, from the first connection", drained_s, 60,
              lambda value: f"{value:.0f} s"),
    ]  # fmt: skip


def _table(goals: Sequence[Goal]) -> str:
    head = "| | measured | goal | |\n| --- | --- | --- | --- |\n"
    return head + "".join(
        f"| {name} | {value} | {goal} | {'' if good else 'missed'} |\n" for name, value, goal, good in goals
    )


def _details(outcomes: dict[str, Outcome]) -> str:
    plan = outcomes["kills"].plan
    text = KILLS.format(plan=plan, backlog=plan.backlog_s // 60, repeat=100 * plan.disturbance.repeat)
    for name, title in (("kills", ""), ("backlog", "## Backlog\n\n"), ("load", "## Many connections\n\n")):
        text += title + "".join(f"- {line}\n" for line in lines(outcomes[name])) + "\n"
    return text.rstrip("\n") + "\n"


if __name__ == "__main__":
    sys.exit(main())
