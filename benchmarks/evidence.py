"""What signatures cost the recorder: `python -m benchmarks.evidence drive.mcap`, with a recording of a whole unit.

Its messages are written as the recorder writes them, with a flush each half second of the drive, once with and once
without signatures, in turns. The cost is the difference of the processor times over the duration of the drive; the
least of each kind counts, because other programs only ever add to it.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks import tables
from shared.bus.envelope import Envelope
from shared.evidence import KeyFile, KeyRing, Outcome, Signer
from shared.recording import Recording, RecordingWriter
from shared.recording.proof import prove
from shared.recording.seals import Sealer

RESULTS = Path(__file__).parent / "results"
GOAL_PERCENT = 1.0  # of one core
FLUSH_NS = 500_000_000
ROUNDS = 7
MEMORY = """
import sys
{}
with open("/proc/self/status") as file:
    print(*(line.split()[1] for line in file if line.startswith(("VmRSS", "RssAnon"))))
"""
USES = "from shared.recording.folder import RecordingFolder\n"
SIGNS = "from shared.evidence.signer import FileSigner\nFileSigner(bytes(32)).sign(b'')\n"


def write(path: Path, envelopes: Sequence[Envelope], signer: Signer | None) -> tuple[float, int]:
    """Write a recording; returns processor time [s] and size [bytes]."""
    sealer = Sealer(signer, vehicle="car") if signer else None
    begin_s = time.process_time()
    writer = RecordingWriter(path, vehicle="car", sealer=sealer)
    flushed_ns = envelopes[0].received_ns
    for envelope in envelopes:
        writer.write(envelope)
        if envelope.received_ns - flushed_ns >= FLUSH_NS:
            flushed_ns = envelope.received_ns
            writer.flush()
    writer.close()
    spent_s = time.process_time() - begin_s
    size = path.stat().st_size
    return spent_s, size


def memory_kb(program: str) -> tuple[int, int]:
    """Resident and private memory [kB] of a process that does something."""
    done = subprocess.run([sys.executable, "-c", MEMORY.format(program)], capture_output=True, text=True, check=True)
    resident, private = map(int, done.stdout.split())
    return resident, private


def check_s(path: Path, ring: KeyRing) -> float:
    """Processor time [s] of the check of the signatures; raises `RuntimeError` if they do not hold."""
    begin_s = time.process_time()
    with Recording(path) as recording:
        proof = prove(recording, ring)
    if proof.outcome is not Outcome.VERIFIED:
        raise RuntimeError(proof.text)
    return time.process_time() - begin_s


def main(arguments: Sequence[str]) -> int:
    """Measure, print and store the result; return 1 if signing takes more than the goal."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.evidence", description=__doc__)
    parser.add_argument("recording", type=Path, help="a recording of a whole unit, such as of `obu demo`")
    parser.add_argument("--no-store", action="store_true", help="print only")
    options = parser.parse_args(arguments)
    with Recording(options.recording) as recording:
        envelopes = list(recording)
    duration_s = (envelopes[-1].received_ns - envelopes[0].received_ns) * 1e-9
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        key = KeyFile(folder / "keys")
        signer = key.signer()
        spent: dict[bool, list[tuple[float, int]]] = {False: [], True: []}
        for number in range(ROUNDS):
            for signs, row in spent.items():
                path = folder / f"{number}-{signs}.mcap"
                row.append(write(path, envelopes, signer if signs else None))
        checked_s = min(check_s(folder / f"{number}-True.mcap", key.ring) for number in range(ROUNDS))
    (plain_s, plain), (signed_s, size) = min(spent[False]), min(spent[True])
    percent = 100.0 * (signed_s - plain_s) / duration_s
    without, with_ = memory_kb(USES), memory_kb(USES + SIGNS)
    check_ms = checked_s * 1e3
    text = f"""# Cost of signatures

By `python -m benchmarks.evidence drive.mcap`: {len(envelopes)} messages of {duration_s:.0f} s of a whole unit, the
least of {ROUNDS} rounds.

| | without | with signatures |
| --- | --- | --- |
| processor time of writing, % of a core | {100.0 * plain_s / duration_s:.2f} | {100.0 * signed_s / duration_s:.2f} |
| size, kB/s | {plain / duration_s * 1e-3:.1f} | {size / duration_s * 1e-3:.1f} |
| resident memory of a process, MB | {without[0] / 1024:.1f} | {with_[0] / 1024:.1f} |
| private memory of a process, MB | {without[1] / 1024:.1f} | {with_[1] / 1024:.1f} |

Signing takes {percent:.2f} % of a core (goal: less than {GOAL_PERCENT:.0f} %); the check takes {check_ms:.0f} ms.
"""
    print(text)
    if not options.no_store:
        tables.publish(RESULTS / "evidence.md", text)
    return 0 if percent < GOAL_PERCENT else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
