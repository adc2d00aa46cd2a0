"""The table of verdicts on drives, and its document."""

import json

from benchmarks import tables
from benchmarks.navigation import trust
from benchmarks.navigation.cases import DRIVES
from cli.reference.wrap import wrap
from cli.solve.metrics.metrics import METRICS, as_objects
from shared.messages.trust import TrustLevel

SECONDS = dict.fromkeys(TrustLevel, 0.0) | {"caution": 50.4, "unsafe": 9.6}
METRICS_OF_ONE = dict.fromkeys(as_objects(dict.fromkeys(METRICS))) | {
    "trust_seconds": SECONDS, "duration_s": 60.0, "gnss_excluded_s": 9.62, "harm_ratio": 1.25,
    "errors_above_level_horizontal": 0.0123, "without_solution_s": 0.0, "horizontal_rmse_m": 0.426,
}  # fmt: skip


def test_a_row_has_seconds_by_verdict_exclusions_shares_and_harm() -> None:
    row = next(trust.rows({"comma": trust.kept(METRICS_OF_ONE)}))
    assert row == (
        "comma", "60 s", "0 s", "50 s", "10 s", "0 s", "0 s", "0 s", "9.6 s", "0 s", "0.426 m", "1.23%", "unknown",
        "1.25",
    )  # fmt: skip
    document = trust.Document(
        measured_at="2026-01-01T00:00:00+00:00", machine="a machine", drives={"comma": trust.kept(METRICS_OF_ONE)}
    )
    text = trust.page(document)
    head = next(line for line in text.splitlines() if line.startswith("| drive |"))
    assert head.count("|") == len(row) + 1 and "DEAD RECKONING" in head and f"| {' | '.join(row)} |\n" in text


def test_the_document_is_that_of_the_last_run() -> None:
    printed = trust.PAGE.read_text(encoding="utf-8").removeprefix(
        f"{tables.OLDER}`make drives-trust` measures it again.\n\n"
    )
    kept = json.loads(trust.RESULTS.read_text(encoding="utf-8"))
    assert printed == wrap(trust.HEAD + trust.page(kept)), "run `make drives-trust`"
    assert set(trust.DRIVES) <= set(DRIVES) and set(kept["drives"]) <= set(trust.DRIVES)
