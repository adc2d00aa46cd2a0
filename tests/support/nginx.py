"""Debian's nginx under a folder of its own, with the configuration of the documentation."""

import re
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.support.patience import HANGS_S

ROOT = Path(__file__).parents[2]
UNPACKED = ROOT / ".obu" / "test-programs" / "usr" / "sbin" / "nginx"
PAGE = ROOT / "docs" / "how-to" / "let-others-look.md"
FRAME = """daemon off; master_process off; pid {folder}/pid; error_log {folder}/error.log;
events {{}}
http {{
access_log {folder}/access.log; client_body_temp_path {folder}/body; proxy_temp_path {folder}/proxy;
fastcgi_temp_path {folder}/fastcgi; uwsgi_temp_path {folder}/uwsgi; scgi_temp_path {folder}/scgi;
{documented}
}}
"""


def executable() -> str:
    """The program, or a skipped test."""
    found = shutil.which("nginx") or next((str(p) for p in (Path("/usr/sbin/nginx"), UNPACKED) if p.exists()), None)
    if found is None or shutil.which("openssl") is None:
        pytest.skip("no nginx or openssl here: deploy/install_test_programs.sh")
    return found


def documented(port: int, upstream: str, folder: Path) -> str:
    """The configuration of the how-to page, with other addresses and a certificate of this folder."""
    found = re.search(r"```nginx\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert found
    text = found[1]
    for before, after in (
        ("listen 443 ssl", f"listen 127.0.0.1:{port} ssl"),
        ("http://127.0.0.1:8080", upstream),
        ("/etc/ssl/car.example/fullchain.pem", str(folder / "certificate.pem")),
        ("/etc/ssl/car.example/privkey.pem", str(folder / "key.pem")),
    ):
        assert before in text
        text = text.replace(before, after)
    return text


@contextmanager
def nginx(folder: Path, port: int, upstream: str) -> Iterator[str]:
    """Run nginx in front of a page; gives its address."""
    program = executable()
    folder.mkdir()
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2",
         "-subj", "/CN=localhost", "-keyout", folder / "key.pem", "-out", folder / "certificate.pem"],
        check=True, capture_output=True,
    )  # fmt: skip
    file = folder / "nginx.conf"
    file.write_text(FRAME.format(folder=folder, documented=documented(port, upstream, folder)))
    with subprocess.Popen([program, "-p", folder, "-c", file], stderr=subprocess.PIPE, text=True) as process:
        try:
            _await_pid(folder / "pid", process)
            yield f"https://localhost:{port}"
        finally:
            process.terminate()
            process.wait(timeout=HANGS_S)


def _await_pid(path: Path, process: subprocess.Popen[str]) -> None:
    until = time.monotonic() + HANGS_S
    while not path.exists():
        assert process.poll() is None, process.stderr.read() if process.stderr else ""
        assert time.monotonic() < until, "nginx does not start"
        time.sleep(0.02)
