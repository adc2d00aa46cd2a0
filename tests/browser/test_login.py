"""The login in a real browser: by link and by hand, wrong, and ended."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect

from services.monitoring.status.web.access.rights import Right
from services.monitoring.status.web.access.tokens import Tokens
from tests.browser.conftest import THEMES
from tests.support.dashboard.chromium import AXE
from tests.support.dashboard.status_server import RunningServer, status_server


@dataclass
class GuardedPage:
    """A page that asks everybody to log in."""

    unit: RunningServer
    tokens: Tokens

    def link(self) -> str:
        secret = self.tokens.add_temporary("link", Right.ADMIN, seconds=60.0, single_use=True)
        return f"{self.unit.address}/login#token={secret}"


@pytest.fixture(scope="module")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[GuardedPage]:
    folder = tmp_path_factory.mktemp("guarded")
    with status_server(folder, login_on_loopback=True, recordings=["download", "keep", "delete"]) as unit:
        yield GuardedPage(unit, Tokens(folder))


def is_login(url: str) -> bool:
    return "/login" in url


@pytest.mark.parametrize("theme", THEMES)
def test_without_a_login_the_page_asks_for_one_and_is_readable(
    guarded: GuardedPage, open_page: Callable[..., Page], theme: str
) -> None:
    page = open_page(guarded.unit.address, theme=theme, path="map")
    page.wait_for_url(is_login)
    expect(page.get_by_label("Token")).to_be_focused()
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    button = page.get_by_role("button", name="Log in").bounding_box()
    assert button and button["height"] >= 44
    ground = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert ground == ("rgb(13, 19, 24)" if theme.endswith("dark") else "rgb(238, 241, 245)")
    page.evaluate(AXE.read_text(encoding="utf-8"))
    found = page.evaluate("axe.run()")["violations"]
    assert not found, [(item["id"], item["help"]) for item in found]


@pytest.mark.parametrize("theme", ["light", "phone-dark"])
def test_a_link_logs_in_once_and_leaves_no_token_in_the_history(
    guarded: GuardedPage, browser: Browser, theme: str
) -> None:
    link = guarded.link()
    context = browser.new_context(viewport=THEMES[theme])
    page = context.new_page()
    asked: list[str] = []
    page.on("request", lambda request: asked.append(f"{request.url} {request.headers.get('referer', '')}"))
    page.goto(link)
    expect(page.locator(".banner")).to_be_visible()
    secret = link.partition("=")[2]
    assert secret not in page.url
    assert not [line for line in asked if secret in line]
    (cookie,) = context.cookies()
    assert (cookie["httpOnly"], cookie["sameSite"], cookie["path"]) == (True, "Strict", "/")
    assert secret not in cookie["value"]
    page.go_back()
    assert secret not in page.url
    page.goto(f"{guarded.unit.address}/#/recordings")
    page.get_by_role("button", name="Log out").click()
    page.wait_for_url(is_login)
    assert not context.cookies()
    page.goto(link)
    expect(page.get_by_role("alert")).to_contain_text("not valid")
    assert secret not in page.url
    context.close()


def test_a_token_by_hand_leads_to_the_page_that_was_asked_for(guarded: GuardedPage, browser: Browser) -> None:
    secret = guarded.tokens.add("hand", Right.VIEW)
    context = browser.new_context(viewport=THEMES["phone"])
    page = context.new_page()
    page.goto(f"{guarded.unit.address}/#/system")
    page.wait_for_url(is_login)
    field = page.get_by_label("Token")
    field.fill("wrong")
    page.get_by_role("button", name="Log in").click()
    expect(page.get_by_role("alert")).to_contain_text("not valid")
    field.fill(f" {secret} ")
    field.press("Enter")
    expect(page.locator(".banner")).to_be_visible()
    assert page.url.endswith("/#/system")
    guarded.tokens.revoke("hand")  # the open page notices it, and asks again
    page.wait_for_url(is_login)
    context.close()


def test_a_change_of_the_page_is_accepted_and_the_role_decides(guarded: GuardedPage, browser: Browser) -> None:
    for right, answer in ((Right.VIEW, "this needs the role operate"), (Right.OPERATE, None)):
        context = browser.new_context()
        page = context.new_page()
        secret = guarded.tokens.add(f"of-{right}", right)
        page.goto(f"{guarded.unit.address}/login#token={secret}")
        expect(page.locator(".banner")).to_be_visible()
        page.goto(f"{guarded.unit.address}/#/trust")
        form = page.locator(".attacks-card")
        form.locator("button[type=submit]").click()
        if answer:
            expect(form).to_contain_text(answer)
        else:
            expect(form.locator(".attack-list li").first).to_be_visible()
            assert guarded.unit.bus.published
        context.close()


def test_a_simulated_unit_on_this_machine_asks_for_nothing(tmp_path: Path, open_page: Callable[..., Page]) -> None:
    with status_server(tmp_path) as server:
        page = open_page(server.address)
        expect(page.locator(".banner")).to_be_visible()
        expect(page.get_by_role("button", name="Log out")).to_have_count(0)
