"""`obu fleet simulate`: thousands of vehicles that report to a centre on this machine."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cli.centre.common import FolderOption, centre_of
from shared.errors import UserError

if TYPE_CHECKING:
    from fleet.simulate.campaign import Outcome


def simulate(  # noqa: PLR0913, PLR0917  # one argument an option
    vehicles: Annotated[int, typer.Option("--vehicles", metavar="COUNT", min=1, max=50_000)] = 100,
    seconds: Annotated[
        float, typer.Option("--seconds", metavar="SECONDS", min=1, help="How long they report, once connected.")
    ] = 60.0,
    folder: FolderOption = None,
    backlog: Annotated[
        int, typer.Option("--backlog", metavar="SECONDS", min=0, max=86_400, help="Reports they have at the start.")
    ] = 0,
    durable: Annotated[
        int,
        typer.Option(
            "--durable", metavar="COUNT", min=0, help="Vehicles among them whose outbox is on the disk, as in a unit."
        ),
    ] = 0,
    repeat: Annotated[
        float, typer.Option("--repeat", metavar="SHARE", min=0, max=1, help="Share of batches that are sent twice.")
    ] = 0.0,
    reorder: Annotated[bool, typer.Option("--reorder", help="Hold every fifth batch back, for up to 3 s.")] = False,
    kills: Annotated[
        int,
        typer.Option(
            "--kills", metavar="COUNT", min=0,
            help="Kill ingest, PostgreSQL, units with outboxes on the disk, and nats-server, in turn, so often.",
        ),
    ] = 0,
    retry: Annotated[
        float, typer.Option("--retry", metavar="SECONDS", min=0.1, help="A batch without a receipt is sent again.")
    ] = 10.0,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE", help="Where the list of batches that were made is written.")
    ] = None,
) -> int:  # fmt: skip
    """Let vehicles report to a centre on this machine, and hold what it has stored against what they made.

    The vehicles are entered into the centre's database, each with its own keys and certificate, and stay there. Ends
    with 1 if a report is lost, stored twice, or was never made.

    Examples:
    [bold]obu fleet simulate --vehicles 1000[/]
    [bold]obu fleet simulate --vehicles 1000 --backlog 600 --repeat 0.2 --reorder[/]
    [bold]obu fleet simulate --vehicles 200 --durable 20 --kills 8 --seconds 120 --out truth.csv[/]
    """
    try:
        from fleet.database.refusals import refusals
        from fleet.simulate.campaign import Campaign, Plan
        from fleet.simulate.traffic import Disturbance
    except ModuleNotFoundError as error:
        raise UserError(
            f"a simulated fleet needs {error.name}: pip install --require-hashes -r requirements-fleet.lock"
        ) from error
    if durable > vehicles:
        raise UserError(f"--durable {durable} is more than --vehicles {vehicles}; give a smaller number")
    plan = Plan(
        vehicles, seconds, durable, backlog_s=backlog, kills=kills, disturbance=Disturbance(repeat, reorder),
        retry_s=retry,
    )  # fmt: skip
    with refusals():
        outcome = Campaign(centre_of(folder), plan, lambda text: print(text, flush=True)).run(out)
    print("\n".join(lines(outcome)))
    return 0 if outcome.verdict.holds and not outcome.waiting else 1


def lines(outcome: "Outcome") -> list[str]:
    """What was found, a line each."""
    verdict, counts = outcome.verdict, outcome.counts
    parts = ", ".join(f"{part} {spent:.1f}" for part, spent in outcome.us_a_report.items())
    memory = ", ".join(f"{part} {size:.0f}" for part, size in outcome.memory_mb.items())
    total_us = sum(outcome.us_a_report.values())
    cores = sum(outcome.cpu_s.values()) / outcome.measured_s
    found = [
        f"reports: {verdict.made} made, {verdict.stored} stored, {verdict.lost} lost, {verdict.double} double, "
        f"{verdict.foreign} foreign; {outcome.waiting} batches without a receipt",
        f"all connected after {outcome.connected_s:.1f} s; {counts['connections']} connections were made",
        f"rate: {outcome.reports / outcome.measured_s:.0f} reports/s for {outcome.measured_s:.0f} s",
        f"receipts: median {1000 * outcome.latency_s[0]:.0f} ms, 99 % within {outcome.latency_s[1]:.2f} s",
        f"processor time: {total_us:.1f} us a report, {cores:.2f} cores ({parts})",
        f"memory [MB]: {memory}",
        "MQTT an OBU and hour [kB]: {:.0f} sent, {:.0f} taken".format(*(size / 1000 for size in outcome.bytes_hour)),
    ]
    if outcome.drained_s is not None:
        found.append(f"backlog stored after {outcome.drained_s:.1f} s")
    if outcome.kills:
        found.append("killed: " + ", ".join(f"{part} {number}" for part, number in outcome.kills.items()))
    if outcome.faults:
        found.append(f"connections lost: {outcome.faults.most_common(3)}")
    return found + verdict.faults
