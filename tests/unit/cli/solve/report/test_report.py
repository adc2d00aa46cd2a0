"""The report of `obu solve` as one page of HTML."""

import re
from functools import cache
from html.parser import HTMLParser
from io import StringIO

import pytest
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawn

from cli.solve.codes import Code
from cli.solve.metrics.counters import Counters
from cli.solve.metrics.errors import errors_against
from cli.solve.metrics.metrics import METRICS, Run, Value, metrics_of
from cli.solve.report.drawing import STYLE, WIDTH_IN, Figure, label_decades, stacked_axes
from cli.solve.report.plots import figures_of
from cli.solve.report.report import Heading, document, judgement, page, summary, verdict
from shared.messages.explanation import explain
from shared.messages.navigation import AidingKind, AidingUpdate
from tests.support.drives.tracks import START_NS, reference, solution, track

S = 1_000_000_000


class Checker(HTMLParser):
    """Collects the external resources, ids and unclosed tags of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.loads: list[str] = []
        self.ids: list[str] = []
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = {name: value or "" for name, value in attrs}
        self.ids += [found["id"]] if "id" in found else []
        targets = [found.get(name, "") for name in ("src", "href", "xlink:href", "data")]
        self.loads += [target for target in targets if target and not target.startswith("#")]
        if tag not in ("meta", "link", "br", "img"):
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if self.open and self.open[-1] == tag:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def draw_report() -> str:
    counters = Counters()
    for k in range(200):
        counters.add_update(AidingUpdate(
            sampled_ns=START_NS + k * S // 4, source="gnss", kind=AidingKind.GNSS_POSITION,
            innovation=(0.1, 0.2, 0.3), innovation_sd=(0.5, 0.5, 0.5), test_ratio=0.5 if k % 9 else 2.0,
            used=bool(k % 9),
        ))  # fmt: skip
    made, truth = track(solution(0.1 * k) for k in range(600)), reference([0.25 * k for k in range(200)])
    errors = errors_against(truth, made, lever_arm_b=(0.0, 0.0, 0.0))
    run = Run(made, counters, errors, [(START_NS + 20 * S, START_NS + 30 * S)], START_NS, START_NS + 60 * S, 200, 40)
    metrics = metrics_of(run)
    heading = Heading("drive <1>", "a circle", "10/30", [("file & co", "SHA-256 0")], 0.001)
    return page(heading, metrics, figures_of(run, truth))


@cache
def report() -> str:
    return draw_report()


def test_every_run_with_truth_has_a_stanford_diagram_of_each_axis() -> None:
    text = report()
    assert 'aria-label="Stanford diagram, horizontal"' in text and 'aria-label="Stanford diagram, vertical"' in text
    assert "protection_vertical_ratio_median" in text


def test_the_page_is_complete_and_has_no_external_resources() -> None:
    text = report()
    checker = Checker()
    checker.feed(text)
    checker.close()
    assert not checker.open and not checker.loads
    assert len(checker.ids) == len(set(checker.ids)), "identifiers are unique within the page"
    assert "url(http" not in text and "@import" not in text and "<script" not in text


def test_the_page_has_all_figures_and_a_summary() -> None:
    text = report()
    titles = re.findall(r"<h2>(.*?)</h2>", text)
    assert re.findall(r"<summary>(.*?)</summary>", text) == ["Figures", "Metrics", "Data sources and settings"]
    assert titles == ["Trajectory", "Position errors", "Velocity errors", "Attitude errors",
                      "Stanford diagram, horizontal", "Stanford diagram, vertical", "Speed", "Innovations",
                      "Sensor biases"]  # fmt: skip
    assert text.count("<svg") == 9 and text.count('role="img"') == 9
    assert "drive &lt;1&gt;" in text and "file &amp; co" in text
    assert len(re.findall(r"<div><dt>", text)) == 3
    assert re.search(r'<p class="verdict">The position is [\d.]+\sm from the truth horizontally', text)
    assert "GNSS was removed once" in text
    assert re.search(r"Above the protection level: \d+ of \d+ horizontal errors", text)
    assert "the integrity risk allows 0.1 %." in text
    assert "Truth: a circle." in text


def test_every_colour_of_a_figure_follows_the_dark_mode_of_the_page() -> None:
    text = report()
    body = text[text.index("</style>") :]
    assert "@media (prefers-color-scheme: dark)" in text and "svg text { fill: var(--ink); }" in text
    fixed = set(re.findall(r"(?<!, )#[0-9a-f]{6}\b", re.sub(r"(href|id)=\"[^\"]*\"|url\([^)]*\)", "", body)))
    blues = {colour for colour in fixed if int(colour[5:7], 16) > int(colour[1:3], 16)}
    assert fixed == blues, "only the counts of the Stanford diagrams have colours of their own"
    used = set(re.findall(r"var\(--([\w-]+), #", body))
    assert used <= set(re.findall(r"--([\w-]+):", text[: text.index("</style>")]))


def test_equal_runs_give_equal_pages_of_bounded_size() -> None:
    assert draw_report() == report()
    assert len(report()) < 500_000


def judged(**values: Value) -> dict[str, Value]:
    known = {"duration_s": 600.0, "fixes_used": 590, "fixes_offered": 600, "fixes_used_fraction": 590 / 600,
             "filter_resets": 0, "innovation_horizontal_rms_m": 2.12}  # fmt: skip
    return {**dict.fromkeys(METRICS), **known, **values}


@pytest.mark.parametrize(
    "values",
    [
        {"fixes_used": 17, "fixes_offered": 229, "fixes_used_fraction": 17 / 229, "filter_resets": 121},
        {"fixes_used": 290, "fixes_used_fraction": 290 / 600},
        {"filter_resets": 3},
        {"filter_resets": 121, "fixes_offered": 0, "fixes_used_fraction": None},
    ],
)
def test_a_solution_that_hardly_used_the_fixes_is_not_sound(values: dict[str, Value]) -> None:
    metrics = judged(**values)
    assert verdict(metrics).startswith("This is no sound solution: ")
    assert "2.12 m" not in verdict(metrics)
    assert "clock" in verdict(metrics) and "axes" in verdict(metrics), "what to try"
    heading = Heading("drive", "none", None, [], clocks=["The clocks are probably 18 s apart."])
    assert summary(heading, metrics)[0] == verdict(metrics, heading.clocks)
    assert document(heading, metrics)["verdict"] == verdict(metrics, heading.clocks)
    assert '<p class="verdict worse">This is no sound solution' in page(heading, metrics, figures_of_nothing())
    assert verdict(metrics, heading.clocks).endswith("The clocks are probably 18 s apart.")


def figures_of_nothing() -> list[Figure]:
    return [Figure("Trajectory", "", "<svg></svg>")]


def test_the_share_of_the_fixes_and_the_resets_are_in_the_verdict() -> None:
    unsound, advice = judgement(
        judged(fixes_used=17, fixes_offered=229, fixes_used_fraction=17 / 229, filter_resets=121)
    )
    assert unsound == explain(Code.UNSOUND, used_count=17, offered_count=229, reset_count=121)
    assert advice == explain(Code.UNSOUND_UNEXPLAINED)
    excluded = judged(fixes_used=17, fixes_used_fraction=0.03, gnss_excluded_s=500.0)
    assert judgement(excluded)[1] == explain(Code.UNSOUND_EXCLUDED)


def test_a_sound_drive_may_be_reset_rarely() -> None:
    assert judgement(judged(filter_resets=2)) == [explain(Code.INNOVATION, innovation_m=2.12)]
    assert judgement(judged(filter_resets=12, duration_s=7200.0))[0].code == Code.INNOVATION
    said = summary(Heading("drive", "none", None, []), judged(filter_resets=1))
    assert "590 of 600 fixes since the alignment were used (98.3 %), and the filter was reset once." in said


def test_a_figure_that_is_drawn_once_is_the_one_that_matplotlib_saves() -> None:
    """`savefig` draws everything twice: its first drawing only finds the layout."""

    def fill(upper: Axes, lower: Axes) -> None:
        upper.plot([0.0, 1.0, 2.0], [3.0, 1.0, 2.0], label="a line")
        upper.legend()
        lower.set(yscale="log", ylim=(0.01, 10.0), xlabel="time [s]")

    drawn: list[str] = []
    with stacked_axes(2, 3.0, drawn.append) as rows:
        fill(*rows)
    with rc_context(STYLE):  # type: ignore[arg-type]  # which names every key
        figure, saved = Drawn(figsize=(WIDTH_IN, 3.0), layout="constrained"), StringIO()
        fill(*figure.subplots(2, 1, sharex=True))
        figure.savefig(saved, format="svg", metadata={"Date": None, "Creator": None}, transparent=True)
    assert drawn == [saved.getvalue()]
    assert "a line" in drawn[0]


def test_decades_of_logarithmic_axes_are_labelled_as_plain_text() -> None:
    drawn: list[str] = []
    with stacked_axes(2, 3.0, drawn.append) as (upper, lower):
        upper.set(yscale="log", ylim=(0.008, 20.0))
        lower.set(ylim=(0.0, 7.0))
        label_decades(upper.yaxis, lower.yaxis)
    labels = re.findall(r"<text[^>]*>([^<]*)</text>", drawn[0])
    assert [label for label in labels if label.startswith("10")] == ["10⁻²", "10⁻¹", "10⁰", "10¹"]
    assert {"0", "2", "4", "6"} <= set(labels), "a linear axis keeps its numbers"
