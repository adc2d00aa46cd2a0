"""A whole centre as `obu centre up` runs it, in a folder of its own."""

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cli.demo.local import free_port
from fleet.centre import Centre
from fleet.servers.nats import program
from fleet.servers.postgres import programs
from shared.errors import UserError
from tests.support.dashboard.status_server import eventually
from tests.support.data import REPOSITORY
from tests.support.fleet.database import missing
from tests.support.fleet.ports import answers

PORTS = ("mqtt_port", "enrol_port", "web_port", "nats_port")


@contextmanager
def running_centre() -> Iterator[Path]:
    """Run a centre on free ports of loopback; gives its folder."""
    try:
        programs()
        program()
    except UserError as error:
        missing(str(error))
    top = Path(tempfile.mkdtemp(prefix="obu-centre-"))
    top.chmod(0o755)  # the server of the database has a user of its own
    folder = top / "centre"
    folder.mkdir(mode=0o711)
    (folder / "centre.toml").write_text("".join(f"{name} = {free_port()}\n" for name in PORTS))
    command = [sys.executable, "-m", "cli", "centre", "up", "--folder", str(folder)]
    with (top / "log").open("wb") as log:
        process = subprocess.Popen(command, cwd=REPOSITORY, stdout=log, stderr=log)
    try:
        port = Centre(folder).settings.enrol_port
        eventually(lambda: answers(port) or process.poll() is not None)
        assert process.poll() is None, (top / "log").read_text()
        yield folder
        process.terminate()
        assert process.wait(60) == 0
        for path in (top / "log", *(folder / "logs").iterdir()):
            assert "Traceback" not in path.read_text()
    finally:
        process.terminate()
        try:
            process.wait(60)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        shutil.rmtree(top, ignore_errors=True)
