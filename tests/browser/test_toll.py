"""The page Toll of a road-side unit: normal, stale, empty and alarm, in light, dark and on a phone."""

import re
from collections.abc import Callable, Iterator

import pytest
from playwright.sync_api import Page, expect

from tests.browser.test_pages import judge_everywhere
from tests.support.dashboard.status_server import RunningServer, status_server
from tests.support.v2x.fake_plaza import FakePlaza

PLAZAS = {
    "normal": FakePlaza(),
    "stale": FakePlaza(silent_after_s=2.0),
    "alarm": FakePlaza(problem="the ledger cannot be used: disk full; make room on its disk"),
    "empty": FakePlaza(empty=True),
}
WORDS: dict[str, str | re.Pattern[str]] = {
    "normal": "SAFE",
    "stale": "NO DATA",
    "alarm": "UNSAFE",
    "empty": re.compile("STARTING|NO DATA"),
}


@pytest.fixture(scope="module")
def plazas(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, RunningServer]]:
    with (
        status_server(tmp_path_factory.mktemp("normal"), plaza=PLAZAS["normal"]) as normal,
        status_server(tmp_path_factory.mktemp("stale"), plaza=PLAZAS["stale"]) as stale,
        status_server(tmp_path_factory.mktemp("alarm"), plaza=PLAZAS["alarm"]) as alarm,
        status_server(tmp_path_factory.mktemp("empty"), plaza=PLAZAS["empty"]) as empty,
    ):
        yield {"normal": normal, "stale": stale, "alarm": alarm, "empty": empty}


@pytest.mark.parametrize("state", list(PLAZAS))
def test_the_page_is_accessible_and_fits_every_screen_in_every_state(
    plazas: dict[str, RunningServer], open_page: Callable[..., Page], state: str
) -> None:
    page = open_page(plazas[state].address, path="toll")
    expect(page.locator(".banner .word")).to_have_text(WORDS[state])
    expect(page.get_by_role("heading", level=2).first).to_be_visible()
    judge_everywhere(page, f"{state}-toll", phone=state == "normal")


def test_a_road_side_unit_opens_on_its_plaza_and_has_no_pages_of_a_vehicle(
    plazas: dict[str, RunningServer], open_page: Callable[..., Page]
) -> None:
    page = open_page(plazas["normal"].address)
    expect(page.get_by_role("heading", name="Plaza example")).to_be_visible()
    links = page.get_by_role("navigation", name="Pages").get_by_role("link")
    expect(links).to_have_text(["Map", "Toll", "Recordings", "System", "Settings"])


def test_vehicles_lanes_passages_and_accounts_are_shown(
    plazas: dict[str, RunningServer], open_page: Callable[..., Page]
) -> None:
    page = open_page(plazas["normal"].address, path="toll")
    legend = page.locator(".plaza-card .legend")
    for sender in ("authenticated: signature, ticket", "issued by an authority that is not trusted: 1", "unsigned: 1"):
        expect(legend).to_contain_text(sender)
    picture = page.get_by_role("img", name="Plaza example from above with 4 tracked vehicles")
    expect(picture.locator(".track")).to_have_count(4)
    expect(picture.locator(".track.undecided")).to_have_count(1)
    expect(picture.locator(".track.unregistered")).to_have_count(1)
    page.get_by_role("region", name="Plaza example").get_by_role("button", name="Table").click()
    expect(page.get_by_role("cell", name="undecided (n2)")).to_be_visible()
    expect(page.get_by_role("cell", name="signed, not verified")).to_have_count(2)
    senders = page.locator(".plaza-card tbody td:last-child")
    expect(senders.locator(".state")).to_have_count(1)  # nothing is green that was not verified
    expect(senders.filter(has=page.locator(".state.safe"))).to_contain_text("chain to a trusted root")
    expect(page.locator(".lanes-card tr", has_text="n3")).to_contain_text("opens")
    expect(page.locator(".account-card tbody tr")).to_contain_text("n1")
    expect(page.locator(".delta-card")).to_contain_text("-2.10 m")
    missed = page.locator(".passages-card tr", has_text="Missed")
    expect(missed).to_contain_text("n1")
    missed.get_by_role("button").click()
    expect(page.get_by_role("dialog", name="Passage")).not_to_contain_text("Passage ID")


def test_a_charge_opens_its_evidence_and_says_how_to_verify_it(
    plazas: dict[str, RunningServer], open_page: Callable[..., Page]
) -> None:
    page = open_page(plazas["normal"].address, path="toll")
    row = page.locator(".passages-card tr", has_text="Charged")
    expect(row).to_contain_text("2.40 EUR")
    row.get_by_role("button").click()
    drawer = page.get_by_role("dialog", name="Passage")
    expect(drawer).to_contain_text("abab")
    expect(drawer).to_contain_text("obu verify-toll")


def test_held_reviewed_and_unconfirmed_charges_are_shown_in_words(
    plazas: dict[str, RunningServer], open_page: Callable[..., Page]
) -> None:
    page = open_page(plazas["normal"].address, path="toll")
    account = page.locator(".account-card")
    expect(account).to_contain_text("waiting for the detector")
    for label, number in (("Held", "2"), ("In review", "3"), ("Not confirmed by a detector", "4"), ("Charges", "5")):
        expect(account.locator("dl.rows > div", has_text=label).first).to_contain_text(number)
    expect(account.locator("tbody tr")).to_contain_text("not closed yet: 4")
    passages = page.locator(".passages-card")
    expect(passages.locator("tr", has_text="Charged")).to_contain_text("not confirmed by a detector")
    expect(passages.locator("tr", has_text="Charged").locator(".state.info")).to_have_count(1)
    expect(passages.locator("tr", has_text="In review")).to_have_count(1)
    passages.locator("tr", has_text="Held").get_by_role("button").click()
    expect(page.get_by_role("dialog", name="Passage")).to_contain_text(
        "It is charged when the lane's detector confirms it"
    )


def test_an_account_that_does_not_agree_is_a_caution_that_names_the_lane(
    tmp_path_factory: pytest.TempPathFactory, open_page: Callable[..., Page]
) -> None:
    with status_server(tmp_path_factory.mktemp("wrong"), plaza=FakePlaza(agrees=False)) as wrong:
        page = open_page(wrong.address, path="toll")
        expect(page.locator(".banner .word")).to_have_text("CAUTION")
        expect(page.locator(".banner .sentence")).to_contain_text("lane n1")
        expect(page.locator(".account-card tbody")).to_contain_text("does not agree")


def test_a_lost_ledger_is_named_as_the_reason(plazas: dict[str, RunningServer], open_page: Callable[..., Page]) -> None:
    page = open_page(plazas["alarm"].address, path="toll")
    expect(page.locator(".banner .sentence")).to_contain_text("Nothing is charged: the ledger cannot be used")
    expect(page.locator(".account-card")).to_contain_text("make room on its disk")


def test_reviews_say_what_decides_them_and_the_camera_queue_says_why_it_keeps(
    plazas: dict[str, RunningServer], open_page: Callable[..., Page]
) -> None:
    page = open_page(plazas["normal"].address, path="toll")
    review = page.locator(".reviews-card tbody tr")
    expect(review).to_have_count(1)
    expect(review).to_contain_text("the lane's detector has not counted it")
    expect(review).to_contain_text("the picture of the lane at the time of the crossing")
    expect(review).to_contain_text("not authenticated")
    expect(page.locator(".pictures-card")).to_contain_text("1 kept, 2 not decided yet")
    expect(page.locator(".pictures-card tbody tr")).to_contain_text("no contract explains the vehicle")
    expect(page.locator(".account-card")).to_contain_text("the plaza allows them")
