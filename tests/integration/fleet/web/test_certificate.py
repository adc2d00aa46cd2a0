"""The certificate of the pages is replaced while they are served."""

import asyncio
import contextlib
import ssl
from pathlib import Path

import pytest
import uvicorn

from fleet.admission.authority import Authority
from fleet.web import process
from tests.support.patience import HANGS_S


def shown_by(server: ssl.SSLContext) -> bytes | None:
    """The certificate that a browser is shown."""
    trust = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    trust.check_hostname, trust.verify_mode = False, ssl.CERT_NONE
    theirs, ours = ssl.MemoryBIO(), ssl.MemoryBIO()
    browser, pages = trust.wrap_bio(theirs, ours), server.wrap_bio(ours, theirs, server_side=True)
    for end in (browser, pages) * 3:
        with contextlib.suppress(ssl.SSLWantReadError):
            end.do_handshake()
    return browser.getpeercert(binary_form=True)


def test_the_pages_have_a_certificate_that_was_made_anew_and_keep_the_last_that_can_be_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process, "READ_PERIOD_S", 0.01)
    authority = Authority(tmp_path)
    certificate, key = authority.server(["localhost"])
    config = uvicorn.Config(lambda: None, ssl_certfile=str(certificate), ssl_keyfile=str(key))
    config.load()
    served = config.ssl
    assert served is not None
    first = shown_by(served)

    async def work() -> None:
        task = asyncio.create_task(process._read_again(uvicorn.Server(config), (certificate, key)))
        good = certificate.read_bytes()
        certificate.unlink()
        await asyncio.sleep(0.1)
        assert shown_by(served) == first
        certificate.write_bytes(good)
        authority.server(["localhost", "centre.example"])
        async with asyncio.timeout(HANGS_S):
            while shown_by(served) == first:
                await asyncio.sleep(0.01)
        task.cancel()

    asyncio.run(work())
    assert shown_by(served) == ssl.PEM_cert_to_DER_cert(certificate.read_text())
