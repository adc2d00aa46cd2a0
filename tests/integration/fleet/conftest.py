from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from fleet.servers.postgres import Postgres
from shared.fleet.identity import UplinkIdentity
from tests.support.fleet.database import database, emptied
from tests.support.fleet.running_centre import running_centre
from tests.support.fleet.vehicle_link import Link


@pytest.fixture(scope="session")
def postgres() -> Iterator[Postgres]:
    with database() as server:
        yield server


@pytest.fixture
def dsn(postgres: Postgres) -> str:
    return emptied(postgres)


@pytest.fixture(scope="session")
def folder() -> Iterator[Path]:
    """Folder of a whole centre that runs."""
    with running_centre() as folder:
        yield folder


@pytest.fixture
def link() -> Iterator[Callable[..., Link]]:
    made: list[Link] = []

    def connect(identity: UplinkIdentity, client_id: str | None = None, *, clean: bool = True) -> Link:
        made.append(Link(identity, client_id, clean=clean))
        return made[-1]

    yield connect
    for item in made:
        item.close()
