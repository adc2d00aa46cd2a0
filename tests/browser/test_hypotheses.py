"""What a person sees while GNSS or the inertial sensors may be wrong: banner, page Trust, and the map."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, ViewportSize, expect

from shared.messages.trust import Hypothesis
from tests.browser.test_pages import faults, judge_everywhere, keep_picture
from tests.support.dashboard.status_server import RunningServer, status_server

SMALL: ViewportSize = {"width": 760, "height": 600}  # WebGL is computed in software here


@pytest.fixture(scope="module")
def suspecting(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningServer]:
    """A unit whose GNSS or IMU may be wrong."""
    with status_server(tmp_path_factory.mktemp("suspecting")) as server:
        assert server.unit
        server.unit.rejecting = True
        server.unit.suspect()
        yield server


def test_the_page_trust_says_which_hypotheses_survive_where_they_are_and_why(
    suspecting: RunningServer, open_page: Callable[..., Page]
) -> None:
    page = open_page(suspecting.address, path="trust")
    banner = page.get_by_role("region", name="Can the position be trusted?")
    expect(banner.locator(".sentence")).to_contain_text(
        "The position must not be used: GNSS or the inertial sensors may be wrong."
    )
    card = page.get_by_role("region", name="Hypotheses")
    gnss = card.locator("tr", has=page.get_by_role("button", name="GNSS is wrong"))
    for text in ("62 %", "prior 1 × 10⁻⁴", "survives", "18.0 m away", "5.2 m", "the free run is 18 m from GNSS"):
        expect(gnss).to_contain_text(text)
    expect(card.locator("tr", has_text="Nothing is wrong")).to_contain_text("ruled out")
    expect(card.locator("tr", has_text="The receiver's time")).to_contain_text(
        "not evaluated: the delay is not estimated while the vehicle stands still"
    )
    satellites = card.get_by_role("button", name="Satellites are wrong")
    expect(card).not_to_contain_text("G17")
    satellites.focus()
    page.keyboard.press("Enter")
    expect(satellites).to_have_attribute("aria-expanded", "true")
    first = card.locator(".satellite-rows tbody tr").first
    expect(first).to_contain_text("G17")
    expect(first).to_contain_text("0.94")
    strip = page.get_by_role("img", name="GNSS is wrong: probability 62 % now, at most 62 % in 15 minutes")
    expect(strip).to_be_attached()
    card.scroll_into_view_if_needed()
    judge_everywhere(page, "hypotheses")


@pytest.mark.slow
def test_the_map_draws_the_alternatives_while_one_is_suspected_and_as_somebody_chose(
    suspecting: RunningServer, open_page: Callable[..., Page]
) -> None:
    unit = suspecting.unit
    assert unit
    page = open_page(suspecting.address, path="map", reduced_motion="reduce", viewport=SMALL)
    legend = page.locator(".map-legend")
    expect(legend).to_contain_text("If GNSS is wrong (survives)")
    expect(legend).to_contain_text("If the odometer is wrong")
    expect(legend).not_to_contain_text("receiver's time")  # it has no solution
    keep_picture(page, "alternatives")
    page.locator("summary", has_text="Layers").click()
    layer = page.get_by_role("checkbox", name="Alternatives")
    expect(layer).to_be_checked()
    suspected, unit.beliefs = (
        unit.beliefs,
        tuple(
            belief.model_copy(update={"survives": belief.hypothesis is Hypothesis.NOTHING, "since_ns": None})
            for belief in unit.beliefs
        ),
    )
    expect(layer).not_to_be_checked()
    expect(legend).not_to_contain_text("If GNSS is wrong")
    layer.check()
    expect(legend).to_contain_text("If GNSS is wrong")
    assert faults(page) == []
    unit.beliefs = suspected
    layer.uncheck()
    expect(legend).not_to_contain_text("If GNSS is wrong")


def test_without_beliefs_and_positions_the_page_trust_says_what_is_missing(
    open_page: Callable[..., Page], tmp_path: Path
) -> None:
    with status_server(tmp_path) as quiet:
        page = open_page(quiet.address, path="trust")
        expect(page.get_by_role("region", name="Hypotheses")).to_contain_text("no position")


@pytest.mark.parametrize(
    ("locale", "language", "sentence"),
    [
        ("de-DE", "de", "Position nicht verwenden, möglicher Fehler: GNSS oder Inertialsensoren."),
        ("fr-FR", "fr", "Ne pas utiliser la position, erreur possible : GNSS ou capteurs inertiels."),
        ("ja-JP", "en", "The position must not be used: GNSS or the inertial sensors may be wrong."),
    ],
)
def test_the_banner_speaks_the_language_of_the_browser_and_otherwise_english(
    suspecting: RunningServer, open_page: Callable[..., Page], locale: str, language: str, sentence: str
) -> None:
    shown = open_page(suspecting.address, locale=locale).locator(".banner .sentence > span").first
    expect(shown).to_have_text(sentence)
    expect(shown).to_have_attribute("lang", language)
