"""Counts of the Stanford diagram for given errors and protection levels."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from matplotlib.figure import Figure

from cli.solve.metrics.errors import errors_against
from cli.solve.metrics.integrity import INTEGRITY, AxisProtection, Region, integrity_metrics, protected
from cli.solve.metrics.metrics import METRICS
from cli.solve.report.drawing import WIDTH_IN
from cli.solve.report.stanford import HEIGHT_IN, draw, stanford
from shared.messages.navigation import NavigationSolution
from tests.support.drives.tracks import reference, solution, track

LIMITS = (10.0, 20.0)
NOWHERE = (0.0, 0.0, 0.0)
# Error and level: two nominal, one unavailable, one misleading, one unavailable and misleading, two hazardous.
PAIRS = np.array([(1.0, 5.0), (9.0, 9.5), (3.0, 12.0), (8.0, 6.0), (15.0, 12.0), (11.0, 9.0), (40.0, 1.0)])
MADE = AxisProtection("horizontal", PAIRS[:, 0], PAIRS[:, 1], 10.0)


def promised(time_s: float, error: float, level: float | None) -> NavigationSolution:
    made = solution(time_s, error_n=(error, 0.0, -error))
    return made.model_copy(update={"protection_level_horizontal_m": level, "protection_level_vertical_m": level})


def test_every_epoch_is_in_one_region() -> None:
    assert MADE.regions() == {
        Region.NOMINAL: 2,
        Region.UNAVAILABLE: 1,
        Region.MISLEADING: 1,
        Region.UNAVAILABLE_MISLEADING: 1,
        Region.HAZARDOUS: 2,
    }


def test_an_error_equal_to_the_level_or_the_limit_is_not_misleading() -> None:
    edge = AxisProtection("vertical", np.array([5.0, 10.0]), np.array([5.0, 10.0]), 10.0)
    assert edge.regions()[Region.NOMINAL] == 2


def test_misleading_information_is_counted() -> None:
    """Error above the level for 20 of 100 s, and for 10 of these above the alert limit."""
    rows = [promised(0.1 * k, 12.0 if k < 100 else 3.0 if k < 200 else 1.0, 2.0) for k in range(1001)]
    found = integrity_metrics(
        errors_against(reference(np.arange(0.05, 99.9, 0.1)), track(rows), lever_arm_b=NOWHERE), LIMITS
    )
    assert list(found) == list(INTEGRITY)
    assert found["protection_horizontal_misleading_count"] == pytest.approx(200, abs=2)
    assert found["protection_horizontal_misleading_fraction"] == pytest.approx(0.2, abs=0.002)
    assert found["protection_horizontal_hazardous_fraction"] == pytest.approx(0.1, abs=0.002)
    assert found["protection_vertical_hazardous_fraction"] == 0.0, "12 m are within the limit of 20 m"
    assert found["protection_horizontal_available_fraction"] == 1.0
    assert found["protection_horizontal_ratio_median"] == pytest.approx(2.0, rel=0.01)
    assert found["protection_horizontal_error_share_max"] == pytest.approx(6.0, rel=0.01)
    assert set(INTEGRITY) < set(METRICS)


def test_misleading_information_is_proven_only_beyond_the_error_of_the_reference() -> None:
    """Levels of 2 m, errors of 3 and 12 m, reference sd of 1 m."""
    rows = [promised(0.1 * k, 12.0 if k < 100 else 3.0, 2.0) for k in range(1001)]
    instants = np.arange(0.05, 99.9, 0.1)
    stated = replace(reference(instants), position_sd_n=np.ones((len(instants), 3)))
    for given, proven in ((reference(instants), 1.0), (stated, 0.1)):
        found = integrity_metrics(errors_against(given, track(rows), lever_arm_b=NOWHERE), LIMITS)
        for axis in ("horizontal", "vertical"):
            assert found[f"protection_{axis}_misleading_fraction"] == 1.0, "errors above the level are always counted"
            assert found[f"protection_{axis}_misleading_proven_fraction"] == pytest.approx(proven, abs=0.002)


def test_solutions_without_protection_levels_have_no_integrity_metrics() -> None:
    rows = [promised(0.1 * k, 1.0, None) for k in range(100)]
    errors = errors_against(reference([1.0, 2.0]), track(rows), lever_arm_b=NOWHERE)
    assert protected(errors, LIMITS) == [] and integrity_metrics(errors, LIMITS) == {}


def test_the_figure_names_its_regions_and_their_counts() -> None:
    figure = stanford(MADE)
    words = figure.svg
    for region, count in MADE.regions().items():
        assert region.value in words
        assert f"{count} ({100.0 * count / 7:.3g} %)" in words
    assert "horizontal error [m]" in words and "horizontal protection level [m]" in words
    assert 'aria-label="Stanford diagram, horizontal"' in figure.svg
    assert stanford(MADE).svg == figure.svg, "the same to the byte"


@pytest.mark.parametrize("limit", [0.01, 1.0, 10.0, 39.9, 1000.0])
def test_the_labels_of_the_regions_overlap_neither_each_other_nor_the_diagram(limit: float) -> None:
    canvas = Figure(figsize=(WIDTH_IN, HEIGHT_IN), layout="constrained")
    axes = canvas.subplots()
    draw(axes, replace(MADE, alert_limit_m=limit))
    canvas.draw_without_rendering()
    legend = axes.get_legend()
    assert legend is not None
    boxes = [text.get_window_extent() for text in legend.get_texts()]
    assert len(boxes) == len(Region)
    assert all(upper.y0 > lower.y1 for upper, lower in pairwise(boxes)), "one below the other"
    lowest = axes.xaxis.get_tightbbox()
    assert lowest is not None and boxes[0].y1 < lowest.y0, "below the label of the axis"
    assert all(box.x1 < canvas.bbox.x1 and box.y0 > canvas.bbox.y0 for box in boxes)
