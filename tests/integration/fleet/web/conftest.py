from collections.abc import Iterator

import pytest

from fleet.servers.postgres import Postgres
from tests.support.fleet.database import emptied
from tests.support.fleet.web import RunningWeb, bus, tenant, web


@pytest.fixture(scope="module")
def running(postgres: Postgres) -> Iterator[RunningWeb]:
    """Pages of two tenants: demo, with an account of each role, and other, with an administrator."""
    dsn = emptied(postgres)
    tenant(dsn)
    tenant(dsn, "other", {"olga": "admin"})
    with bus() as nats_url, web(dsn, nats_url) as pages:
        yield pages
