"""What an operator sees and does on the pages of a centre."""

import re
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from urllib.parse import urlsplit

import psycopg
import pytest
from playwright.sync_api import Page, Route, WebSocketRoute, expect

from tests.browser.test_pages import judge_everywhere
from tests.support.fleet.reports import Unit
from tests.support.fleet.watched_unit import watched_unit
from tests.support.fleet.web import PASSWORD, RunningWeb
from tests.support.patience import HANGS_S


class Line:
    """The stream of a page, which can be cut."""

    def __init__(self) -> None:
        self.streams: list[WebSocketRoute] = []
        self.is_lost = False

    def connect(self, route: WebSocketRoute) -> None:
        if self.is_lost:
            route.close()
            return
        route.connect_to_server()
        self.streams.append(route)

    def cut(self) -> None:
        self.is_lost = True
        self.streams[-1].close()


def wait_for_map(page: Page) -> None:
    expect(page.locator(".fleet-page .maplibregl-canvas")).to_be_visible()
    expect(page.locator(".map-wait")).to_have_count(0)


@pytest.mark.parametrize("path", ["map", "vehicles/car-unsafe", "alarms", "passages", "enrolment", "accounts", "audit",
                                  "account"])  # fmt: skip
def test_each_page_is_accessible_in_light_and_dark_and_on_a_phone_and_asks_nobody_else(
    centre: RunningWeb, open_centre: Callable[..., Page], path: str
) -> None:
    requests: list[str] = []
    page = open_centre("api/session")
    page.on("request", lambda request: requests.append(request.url))
    page.goto(f"{centre.address}/#/{path}")
    expect(page.get_by_role("heading", level=2).first).to_be_visible()
    if path == "map":
        wait_for_map(page)
    judge_everywhere(page, f"centre-{path.replace('/', '-')}")
    assert {urlsplit(url).netloc for url in requests if not url.startswith(("data:", "blob:"))} == {
        urlsplit(centre.address).netloc
    }


def test_the_login_leads_to_the_page_that_was_asked_for(centre: RunningWeb, open_page: Callable[..., Page]) -> None:
    page = open_page("about:blank")
    page.goto(f"{centre.address}/#/alarms")
    expect(page).to_have_url(re.compile("/login#/alarms$"))
    judge_everywhere(page, "centre-login")
    page.get_by_label("Name").fill("vera")
    page.get_by_label("Password").fill(PASSWORD)
    page.get_by_role("button", name="Log in").click()
    expect(page.get_by_role("heading", name="Alarms", level=1)).to_be_attached()
    expect(page.get_by_role("button", name=re.compile("^Acknowledge"))).to_have_count(0)
    navigation = page.get_by_role("navigation")
    expect(navigation.get_by_role("link")).to_have_text(["Map", "Alarms"])
    page.get_by_role("button", name="Log out vera").click()
    expect(page).to_have_url(re.compile("/login$"))


def test_the_map_and_the_list_show_each_verdict_by_shape_and_word(open_centre: Callable[..., Page]) -> None:
    page = open_centre("#/map")
    wait_for_map(page)
    expect(page.locator(".fleet-list tbody tr")).to_have_count(7)
    expect(page.locator(".fleet-list tbody tr").first).to_contain_text("car-unsafe")
    expect(page.locator(".fleet-list tbody tr").first).to_contain_text("UNSAFE")
    expect(page.locator(".fleet-list tbody tr", has_text="car-old")).to_contain_text("CAUTION OLD")
    group = page.get_by_role("group", name="Verdicts")
    expect(group.get_by_role("button", name="1 UNSAFE")).to_be_visible()
    expect(group.get_by_role("button", name="1 OLD")).to_be_visible()
    group.get_by_role("button", name="1 UNSAFE").click()
    expect(page.locator(".fleet-list tbody tr")).to_have_count(1)
    page.get_by_role("button", name="Show all").click()
    page.get_by_role("searchbox", name="Find a vehicle").fill("tunnel")
    expect(page.locator(".fleet-list tbody tr")).to_have_count(1)
    page.get_by_role("searchbox").fill("nothing like it")
    expect(page.get_by_text("No vehicle matches")).to_be_visible()


def test_a_chosen_vehicle_is_shown_on_the_map_with_its_track(open_centre: Callable[..., Page]) -> None:
    page = open_centre("#/map")
    wait_for_map(page)
    with page.expect_response(re.compile("/api/vehicles/car-tunnel/trail")) as trail:
        page.get_by_role("button", name="car-tunnel").click()
    assert trail.value.json()["verdict"] == [0, 2, 2]
    box = page.get_by_role("region", name="car-tunnel")
    expect(box).to_contain_text("DEAD RECKONING")
    with page.expect_response(re.compile(r"/tiles/1[4-9]/.*mvt")):
        box.get_by_role("button", name="Show on the map").click()
    box.get_by_role("link", name="Open vehicle").click()
    expect(page.get_by_role("heading", name="Vehicle car-tunnel", level=1)).to_be_attached()


def test_a_change_of_verdict_reaches_the_open_map(centre: RunningWeb, open_centre: Callable[..., Page]) -> None:
    unit = Unit("car-turns", 91, time.time_ns() // 1_000_000)
    unit.next = 3_400_000
    unit.enter(centre.dsn)
    centre.report(unit, 0)
    page = open_centre("#/map")
    wait_for_map(page)
    expect(page.locator(".fleet-list tr", has_text="car-turns")).to_contain_text("SAFE")
    centre.report(unit, 5)
    expect(page.locator(".fleet-list tr", has_text="car-turns")).to_contain_text("UNSAFE")
    expect(page.get_by_role("alert").filter(has_text="car-turns: UNSAFE")).to_be_attached()


def test_an_alarm_is_acknowledged_and_another_one_appears_by_itself(
    centre: RunningWeb, open_centre: Callable[..., Page]
) -> None:
    page = open_centre("#/alarms", "otto")
    silent = page.locator("tr", has_text="car-old")
    silent.get_by_role("button", name="Acknowledge Silent of car-old").click()
    expect(silent).to_contain_text("otto,")
    expect(silent.get_by_role("button")).to_have_count(0)
    expect(page.get_by_role("heading", name="Web hook")).to_have_count(0)
    centre.rows("INSERT INTO alarm (tenant_id, vehicle, kind, since_ms) VALUES (1, 'car-lost', 'gap', 1) RETURNING 1")
    centre.publish("centre.alarm", {"tenant_id": 1, "alarm_id": 99, "vehicle": "car-lost", "kind": "gap"})
    expect(page.locator("tr", has_text="car-lost")).to_contain_text("Gap in the evidence")


def test_a_token_is_shown_with_its_command_and_a_vehicle_is_revoked_after_a_question(
    centre: RunningWeb, open_centre: Callable[..., Page]
) -> None:
    page = open_centre("#/enrolment/car-new")  # as the code of a unit's page Set up has it
    expect(page.get_by_label("Name of the vehicle")).to_have_value("car-new")
    page.get_by_role("button", name="Make a token").click()
    command = re.compile(r"^obu enrol https://centre\.example:8444 \S+\.(ab){16} --name car-new$")
    expect(page.locator(".command")).to_have_text(command)
    expect(page.locator("tr", has_text="car-new")).to_contain_text("valid until")
    page.reload()
    expect(page.locator("tr", has_text="car-new")).to_be_visible()
    expect(page.locator(".command")).to_have_count(0)
    page.get_by_label("Find a vehicle").fill("zzz")
    expect(page.get_by_text("No vehicle matches")).to_be_visible()
    page.get_by_label("Find a vehicle").fill("")
    page.get_by_role("button", name="Revoke car-start").click()
    question = page.get_by_role("group", name="Revoke car-start")
    question.get_by_label("Reason").fill("sold")
    question.get_by_role("button", name="Revoke", exact=True).click()
    expect(page.locator("tr", has_text="car-start")).to_contain_text("revoked")
    page.goto(f"{centre.address}/#/audit")
    expect(page.locator("tr", has_text="car-start")).to_contain_text("sold")


def test_a_mistyped_address_names_no_vehicle_and_leaves_the_pages_working(open_centre: Callable[..., Page]) -> None:
    page = open_centre("#/vehicles/%zz")
    expect(page.get_by_text("There is no such vehicle")).to_be_visible()
    page.get_by_role("navigation").get_by_role("link", name="Alarms").click()
    expect(page.get_by_role("heading", name="Alarms", level=1)).to_be_attached()


def test_an_address_of_no_page_leads_back(centre: RunningWeb, open_centre: Callable[..., Page]) -> None:
    page = open_centre("api/session")
    page.route("**/no/such/page", lambda route: route.fulfill(response=route.fetch(), status=200))  # 404 is an error
    page.goto(f"{centre.address}/no/such/page")
    expect(page.get_by_role("heading", name="There is no such page")).to_be_visible()
    judge_everywhere(page, "centre-no-such-page")
    page.get_by_role("link", name="Back to the first page").click()
    expect(page).to_have_url(re.compile(f"^{re.escape(centre.address)}/"))
    expect(page.get_by_role("heading", name="Map", level=1)).to_be_attached()


def test_a_button_that_does_nothing_looks_so(open_centre: Callable[..., Page]) -> None:
    page = open_centre("#/audit")
    newest = page.get_by_role("button", name="Newest")
    expect(newest).to_be_disabled()
    expect(newest).to_have_css("cursor", "default")
    expect(newest).to_have_css("border-style", "dashed")
    newest.hover(force=True)
    expect(newest).to_have_css("background-color", page.locator(".card").first.evaluate(
        "card => getComputedStyle(card).backgroundColor"))  # fmt: skip


@pytest.mark.parametrize(("path", "card"), [("audit", "audit"), ("enrolment", "tokens")])
def test_rows_stand_below_each_other_and_within_a_phone(
    centre: RunningWeb, open_centre: Callable[..., Page], path: str, card: str
) -> None:
    with psycopg.connect(centre.dsn) as db:
        db.execute(
            "INSERT INTO enrolment (token_hash, tenant_id, vehicle, made_by, expires) "
            "SELECT sha256(n::text::bytea), 1, 'car-phone', 'somebody with a long name', now() + interval '1 day' "
            "FROM generate_series(1, 2) AS n ON CONFLICT DO NOTHING"
        )
        db.execute(
            "INSERT INTO audit (tenant_id, who, action, vehicle, detail) SELECT 1, 'anna', 'revoked', 'car-phone', "
            "jsonb_build_object('reason', repeat('a long reason ', 15)) FROM generate_series(1, 2)"
        )
    page = open_centre(f"#/{path}", viewport={"width": 390, "height": 844})
    rows = page.locator(f"[aria-labelledby={card}] tbody tr")
    expect(rows.nth(1)).to_be_visible()
    boxes = rows.evaluate_all("""rows => rows.map((row) => {
        const words = document.createRange();
        words.selectNodeContents(row);
        const boxes = [...words.getClientRects()];
        const furthest = (side) => Math.max(...boxes.map((box) => box[side]));
        return [row.getBoundingClientRect().top, furthest("bottom"), furthest("right")];
    })""")
    for (_, bottom, _), (top, _, _) in pairwise(boxes):
        assert bottom <= top + 1
    assert max(right for _, _, right in boxes) <= 390


def test_pages_of_another_role_say_so(open_centre: Callable[..., Page]) -> None:
    page = open_centre("#/audit", "otto")
    expect(page.get_by_text("This page is not part of your role")).to_be_visible()
    toll = open_centre("#/map", "tom")
    expect(toll.get_by_text("This page is not part of your role")).to_be_visible()
    expect(toll.get_by_role("navigation").get_by_role("link")).to_have_text(["Passages"])


def test_a_page_that_loses_the_centre_says_so_and_keeps_what_it_knows(
    centre: RunningWeb, open_centre: Callable[..., Page]
) -> None:
    page = open_centre("api/session")
    line = Line()
    page.route_web_socket("**/ws", line.connect)
    page.goto(f"{centre.address}/#/map")
    expect(page.locator(".fleet-list tbody tr").first).to_be_visible()
    page.route("**/api/vehicles*", lambda route: route.fulfill(status=503, json={"detail": "the database is away"}))
    line.cut()
    expect(page.get_by_text("Connection to the centre lost")).to_be_visible()
    expect(page.get_by_text("The centre refused this: the database is away")).to_be_visible()
    expect(page.locator(".fleet-list tbody tr").first).to_be_visible()
    line.is_lost = False
    page.unroute("**/api/vehicles*")
    expect(page.get_by_text("Connection to the centre lost")).to_have_count(0)
    expect(page.get_by_text("the database is away")).to_have_count(0)


@pytest.mark.parametrize(("path", "where", "number"), [("map", ".fleet-list tr", 93), ("vehicles/car-94", "main", 94)])
def test_what_is_shown_of_a_lost_centre_goes_on_to_age(
    centre: RunningWeb, open_centre: Callable[..., Page], path: str, where: str, number: int
) -> None:
    unit = Unit(f"car-{number}", number, time.time_ns() // 1_000_000)
    unit.enter(centre.dsn)
    centre.report(unit, 0)
    page = open_centre("api/session")
    page.clock.install()
    page.goto(f"{centre.address}/#/{path}")
    verdict = page.locator(where, has_text=f"car-{number}").locator(".fleet-verdict")
    expect(verdict).to_have_text("SAFE")
    page.route("**/api/vehicles*", lambda route: route.abort("connectionrefused"))
    page.route("**/api/vehicles/*", lambda route: route.abort("connectionrefused"))
    page.clock.fast_forward(200_000)
    expect(page.get_by_text("The centre does not answer").first).to_be_visible()
    page.clock.run_for(12_000)  # asked again, and not answered
    expect(verdict).to_contain_text("OLD")


def test_a_vehicle_is_watched_on_its_own_page_and_seen_to_be_from_afar(
    centre: RunningWeb, open_centre: Callable[..., Page], tmp_path: Path
) -> None:
    with watched_unit(centre, "car-safe", tmp_path):
        page = open_centre("#/vehicles/car-safe", "otto")
        missing: list[str] = []
        page.on("response", lambda answer: missing.append(answer.url) if answer.status >= 400 else None)
        page.get_by_role("link", name="Watch live").click()
        banner = page.get_by_role("region", name="Can the position be trusted?")
        expect(banner.locator(".word")).to_have_text("SAFE")
        expect(page.locator(".origin.watched")).to_contain_text("SEEN FROM AFAR")
        expect(page.get_by_role("navigation").get_by_role("link")).to_have_text(["Now", "Map", "GNSS", "Trust"])
        expect(page.get_by_role("region", name="Position", exact=True)).to_contain_text("32.4 km/h")
        judge_everywhere(page, "centre-watch-now")
        page.set_viewport_size({"width": 390, "height": 844})
        cut = "[...document.querySelectorAll('.origin span')].filter((one) => one.scrollWidth > one.clientWidth)"
        assert page.evaluate(f"{cut}.map((one) => one.innerText)") == []
        for name in ("map", "gnss", "trust"):
            page.goto(f"{centre.address}/vehicles/car-safe/live/#/{name}")
            expect(page.get_by_role("heading", level=2).first).to_be_visible()
        page.goto(f"{centre.address}/vehicles/car-safe/live/#/map")
        page.wait_for_selector(".maplibregl-canvas")
        page.get_by_role("link", name="Control centre").click()
        assert missing == []
        expect(page).to_have_url(f"{centre.address}/#/vehicles/car-safe")


def test_a_watched_page_that_loses_the_centre_names_the_centre(
    centre: RunningWeb, open_centre: Callable[..., Page], tmp_path: Path
) -> None:
    line = Line()
    with watched_unit(centre, "car-safe", tmp_path):
        page = open_centre("api/session", "otto")
        page.route_web_socket(re.compile(r"/live/ws"), line.connect)
        page.goto(f"{centre.address}/vehicles/car-safe/live/")
        banner = page.get_by_role("region", name="Can the position be trusted?")
        expect(banner.locator(".word")).to_have_text("SAFE")
        line.cut()
        bar = page.locator(".bar.lost")
        expect(bar).to_contain_text("Connection to the control centre lost")
        expect(bar).not_to_contain_text("are you on its network")


def test_a_vehicle_that_does_not_answer_is_said_to_be_away(open_centre: Callable[..., Page]) -> None:
    page = open_centre("vehicles/car-caution/live/", "otto")
    banner = page.get_by_role("region", name="Can the position be trusted?")
    expect(banner.locator(".word")).to_have_text("NO CONNECTION")
    expect(banner).to_contain_text("The vehicle sends nothing")
    expect(page.get_by_text("Last report: CAUTION")).to_be_visible()


def test_a_page_that_fails_says_so_and_the_others_go_on(
    centre: RunningWeb, open_centre: Callable[..., Page], no_page_fails: list[str]
) -> None:
    page = open_centre("api/session", expected=("broken for a test",))
    broken = "export function AlarmsPage() { throw new TypeError('broken for a test'); }"
    page.route("**/alarms.js", lambda route: route.fulfill(body=broken, content_type="text/javascript"))
    page.goto(f"{centre.address}/#/alarms")
    expect(page.get_by_role("main").get_by_role("alert")).to_contain_text("This part of the page cannot be shown")
    assert no_page_fails and all("broken for a test" in text for text in no_page_fails)
    no_page_fails.clear()
    page.get_by_role("link", name="Map").click()
    expect(page.get_by_text("This part of the page cannot be shown")).to_have_count(0)
    expect(page.get_by_role("main")).to_contain_text("car-safe")


def test_a_verdict_that_is_old_has_no_colour_of_a_verdict_anywhere(
    centre: RunningWeb, open_centre: Callable[..., Page]
) -> None:
    unit = Unit("car-parked", 92, time.time_ns() // 1_000_000 - 600_000)
    unit.next = 3_800_000
    unit.enter(centre.dsn)
    centre.report(unit, 0)
    page = open_centre("#/map")
    row = page.locator(".fleet-list tbody tr", has_text="car-parked")
    expect(row).to_contain_text("SAFE OLD")
    expect(row.locator(".state.safe")).to_have_count(0)
    expect(row.locator(".state.stale")).to_have_count(1)
    page.goto(f"{centre.address}/#/vehicles/car-parked")
    newest = page.get_by_role("region", name="car-parked")
    expect(newest).to_contain_text("SAFE OLD")
    expect(newest.locator(".state.safe")).to_have_count(0)


def test_one_vehicle_has_one_verdict_on_a_page_whatever_was_asked_when(
    centre: RunningWeb, open_centre: Callable[..., Page]
) -> None:
    unit = Unit("car-late", 193, time.time_ns() // 1_000_000)
    unit.next = 4_200_000
    unit.enter(centre.dsn)
    centre.report(unit, 0)
    page = open_centre("#/map")
    wait_for_map(page)
    page.get_by_role("button", name="car-late").click()
    chosen = page.get_by_role("region", name="car-late")
    expect(chosen).to_contain_text("SAFE")
    answers = dict[str, str]()

    def as_before(route: Route) -> None:
        """An answer that was asked for before what the stream says."""
        if route.request.url not in answers:
            answers[route.request.url] = route.fetch().text()
        route.fulfill(body=answers[route.request.url], content_type="application/json")

    page.route(re.compile(r"/api/vehicles(/car-late)?$"), as_before)
    with page.expect_response(re.compile(r"/api/vehicles$")), page.expect_response(re.compile("/car-late$")):
        pass
    centre.report(unit, 5)
    for place in (chosen, page.locator(".fleet-list tr", has_text="car-late")):
        expect(place).to_contain_text("UNSAFE")
        expect(place.locator(".state.safe")).to_have_count(0)
    page.unroute_all()


HOSTILE = '{"<img src=x onerror=alert(1)>": {"a": [{"b": {"c": {"d": 1}}}]}}'


def test_events_are_sentences_and_nothing_on_a_page_has_brackets(
    centre: RunningWeb, open_centre: Callable[..., Page]
) -> None:
    unit = Unit("car-events", 194, time.time_ns() // 1_000_000)
    unit.enter(centre.dsn)
    centre.report(unit, 0)
    contents = {
        "trust/event": '{"before": "safe", "after": "unsafe", "reasons": ["Two satellites disagree"], "monitors": []}',
        "outage/event": '{"what": "gnss/fix", "since_ns": 0, "until_ns": 12000000000, "cause": "unplugged"}',
        "toll/transaction": '{"kind": "charge", "plaza": "west", "lane": "2", "amount_cents": 120, "currency": "EUR"}',
        "uplink/gap": '{"why": "full", "bytes": 50000000}',
        "uplink/clock": '{"before_ms": 1000, "after_ms": 3000, "source": "gnss"}',
        "a/b": HOSTILE,
        "trust/state": HOSTILE,
    }
    for number, (name, content) in enumerate(contents.items()):
        centre.rows(
            "INSERT INTO event (vehicle, epoch, sequence, tenant_id, utc_ms, name, content) "
            "VALUES ('car-events', 1, %s, 1, %s, %s, %s) RETURNING 1", number, unit.now_ms, name, content,
        )  # fmt: skip
    page = open_centre("#/vehicles/car-events")
    events = page.get_by_role("region", name="Events", exact=True)
    for sentence in (
        "The verdict became UNSAFE, before SAFE. Two satellites disagree.",
        "An outage of gnss/fix ended after 12 s. unplugged.",
        "1.20 EUR was charged at west, lane 2.",
        "The outbox was full at 50 MB: its oldest positions were dropped.",
        "The clock of the unit was set forward by 2.0 s, by gnss.",
    ):
        expect(events).to_contain_text(sentence)
    expect(events).not_to_contain_text(re.compile(r"[{}\[\]]"))
    assert events.locator("img").count() == 0


def test_an_error_of_the_program_of_a_page_is_counted_at_the_centre(
    open_centre: Callable[..., Page], no_page_fails: list[str]
) -> None:
    page = open_centre("#/audit")
    with page.expect_response(re.compile("/api/page-error$")) as told:
        page.evaluate("setTimeout(() => { throw new Error('a fault of the page') })")
    assert told.value.status == 202
    expect(page.get_by_role("region", name="Audit")).to_contain_text("a fault of the page", timeout=1000 * HANGS_S)
    assert "a fault of the page" in no_page_fails.pop()
