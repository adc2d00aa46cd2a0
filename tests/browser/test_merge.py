"""The page merges differences as the server means them: its state is the snapshot, nulls included."""

import json
from collections.abc import Iterator
from itertools import pairwise

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from playwright.sync_api import Browser, Page

from services.monitoring.status.web.stream.patch import difference
from tests.support.dashboard.snapshots import Tree, as_json, trees
from tests.support.dashboard.status_server import status_server

AT_ONCE = 40  # sequences of states in one call of the page
MERGED = """async (text) => {
  const { merge } = await import(new URL("store.js", document.baseURI));
  return JSON.stringify(JSON.parse(text).map(({ first, frames }) =>
    frames.reduce((states, { state, removed }) => [...states, merge(states.at(-1), state, removed)], [first])));
}"""


@pytest.fixture(scope="module")
def page(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with status_server(tmp_path_factory.mktemp("merge"), unit=False) as running:
        page = browser.new_page()
        page.goto(running.address)
        yield page
        page.close()


@settings(max_examples=10, deadline=None, phases=[Phase.generate], suppress_health_check=list(HealthCheck))
@given(st.lists(st.lists(trees, min_size=2, max_size=5), min_size=AT_ONCE, max_size=AT_ONCE))
def test_a_page_that_merges_the_differences_knows_the_snapshot(page: Page, runs: list[list[Tree]]) -> None:
    frames = [[difference(old, new) for old, new in pairwise(run)] for run in runs]
    cases = [
        {"first": run[0], "frames": [{"state": d.changed, "removed": d.removed} for d in steps]}
        for run, steps in zip(runs, frames, strict=True)
    ]
    assert as_json(json.loads(page.evaluate(MERGED, json.dumps(cases)))) == as_json(runs)
