"""A database on a disk that is really full: nothing is stored by halves, and everything once when there is room."""

import subprocess
import sys
from pathlib import Path

import pytest

from fleet.servers.postgres import programs
from shared.errors import UserError
from tests.support.data import REPOSITORY
from tests.support.fleet.database import missing
from tests.support.patience import HANGS_S

# Mounted as root of a namespace; PostgreSQL refuses root, and is nobody in another one within.
SMALL_DISK = (
    'mount -t tmpfs -o size=200m,mode=777 none "$1"; '
    'exec unshare --user --map-user=65534 --map-group=65534 "$2" -c "$3" "$1"'
)
ON_A_SMALL_DISK = """
import sys
from pathlib import Path

import psycopg
from fleet.database.maintenance import prepare
from fleet.database.roles import ROLES
from fleet.ingest.store import Store, DatabaseUnavailable
from fleet.ingest.verification import VerifiedBatch
from fleet.servers.postgres import Postgres
from shared.fleet.sealed import chain_digest, unsealed
from tests.support.fleet.reports import Unit

disk = Path(sys.argv[1])
server = Postgres(disk / "postgres", 5432)
server.start()
prepare(server.dsn, dict.fromkeys(ROLES, "x"))
unit, store = Unit("car-1"), Store(server.dsn)
unit.enter(server.dsn)
outbox, receipted = [], set()

def send():
    try:
        _, refused = store.store(outbox[:20])
    except DatabaseUnavailable as error:
        return str(error)
    assert refused == {}, refused
    receipted.update(one.digest for one in outbox[:20])
    del outbox[:20]
    return None

def make(count):
    for number in range(count):
        data = unit.events(*["trust/event"] * 50) if number % 5 == 0 else unit.positions([0] * 10)
        outbox.append(VerifiedBatch("car-1", 1, data, chain_digest(data), unsealed(data).batch, None))

make(200)
while outbox:
    assert send() is None
filler = (disk / "filler").open("wb", buffering=0)
try:
    while True:
        filler.write(bytes(4096))
except OSError:
    pass
make(2000)
why = [said for _ in range(200) if (said := send()) is not None]
assert len(why) > 20 and any("No space left on device" in said for said in why), why[-3:]
assert outbox, "the disk was not full"
filler.close()
(disk / "filler").unlink()
if not server.is_running:
    server.start()
outbox += [one for one in outbox if hash(one.digest) % 5 == 0]  # repeated
for _ in range(400):
    if not outbox:
        break
    send()
assert not outbox
with psycopg.connect(server.dsn) as db:
    found = db.execute("SELECT digest FROM segment").fetchall()
    assert len(found) == 2200 and {bytes(row[0]) for row in found} == receipted
    assert db.execute("SELECT received, highest, lost FROM epoch").fetchall() == [(unit.next, unit.next, 0)]
    assert db.execute("SELECT count(*) FROM event").fetchone() == (440 * 50,)
store.close()
server.stop()
print("whole")
"""


def test_a_full_database_answers_nothing_and_stores_each_report_once_when_there_is_room(tmp_path: Path) -> None:
    try:
        programs()
    except UserError as error:
        missing(str(error))
    tmp_path.chmod(0o755)
    inside = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-ec", SMALL_DISK, "sh", str(tmp_path)]
    if subprocess.run([*inside, sys.executable, "pass"], capture_output=True, check=False).returncode:
        pytest.skip("this system lets no ordinary user mount a small disk")
    done = subprocess.run(
        [*inside, sys.executable, ON_A_SMALL_DISK],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        timeout=HANGS_S,
        check=False,
    )
    assert done.stdout.endswith("whole\n"), done.stdout[-2000:] + done.stderr[-3000:]
