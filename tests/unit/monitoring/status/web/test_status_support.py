"""The button *Download diagnostics*: what `obu support` collects, by a child process of the page."""

import asyncio
import subprocess
import threading
import zipfile
from pathlib import Path

import pytest
from fastapi import HTTPException
from fastapi.responses import FileResponse

from services.monitoring.status.web import made_file
from services.monitoring.status.web.access.tokens import Tokens
from services.monitoring.status.web.made_file import MadeFiles, Making
from services.monitoring.status.web.support import SupportApi


@pytest.fixture
def api(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> SupportApi:
    (tmp_path / "vehicle.toml").write_text('[vehicle]\nname = "car"\n')
    for name, value in (("OBU_VEHICLE", tmp_path / "vehicle.toml"), ("OBU_STATE", tmp_path)):
        monkeypatch.setenv(name, str(value))
    monkeypatch.setenv("OBU_BROKER", "mqtt://127.0.0.1:9")
    return SupportApi(MadeFiles(tmp_path / "jobs"), Tokens(tmp_path))


def send(answer: FileResponse, method: str = "HEAD") -> None:
    """Let it end as the server does, behind which its folder is deleted."""

    async def receive() -> dict[str, str]:
        await asyncio.Event().wait()  # the client stays
        return {"type": "http.disconnect"}

    async def sent(_message: object) -> None:
        pass

    asyncio.run(answer({"type": "http", "method": method, "headers": []}, receive, sent))


def test_it_is_one_file_that_leaves_nothing_behind(api: SupportApi, tmp_path: Path) -> None:
    answer = api.collect()
    assert ".zip" in answer.headers["Content-Disposition"]
    with zipfile.ZipFile(answer.path) as archive:
        assert {"doctor.txt", "vehicle.toml", "health.json"} <= set(archive.namelist())
    send(answer)
    assert not list((tmp_path / "jobs").iterdir()) and not Tokens(tmp_path).content().tokens


def test_a_timeout_leaves_neither_a_file_nor_a_login(
    api: SupportApi, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def late(command: list[str], **_options: object) -> None:
        path = Path(command[command.index("-o") + 1])
        path.with_name("part-of-it").write_bytes(b"x")
        assert Tokens(tmp_path).content().tokens
        raise subprocess.TimeoutExpired(command, 120.0)

    monkeypatch.setattr(subprocess, "run", late)
    with pytest.raises(HTTPException, match="obu support"):
        api.collect()
    assert not list((tmp_path / "jobs").iterdir()) and not Tokens(tmp_path).content().tokens


def test_two_at_once_are_one_too_many(api: SupportApi, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    begun, go_on = threading.Event(), threading.Event()

    def run(_making: Making, folder: Path) -> None:
        begun.set()
        go_on.wait()
        (folder / "made.zip").write_bytes(b"")

    monkeypatch.setattr(made_file, "_run", run)
    answers: list[FileResponse] = []
    first = threading.Thread(target=lambda: answers.append(api.collect()))
    first.start()
    begun.wait()
    with pytest.raises(HTTPException, match="wait") as refused:
        api.collect()
    go_on.set()
    first.join()
    assert refused.value.status_code == 409
    send(answers[0], "GET")
    assert not list((tmp_path / "jobs").iterdir()) and not Tokens(tmp_path).content().tokens


def test_what_kept_it_from_collecting_is_said(api: SupportApi, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OBU_STATE", str(tmp_path / "vehicle.toml"))
    with pytest.raises(HTTPException) as failed:
        api.collect()
    assert failed.value.status_code == 500 and failed.value.detail
    assert not list((tmp_path / "jobs").iterdir())
