"""The coarse geoid against the published one, at places between its points, and where the grid closes."""

import pytest

from shared.maths.geoid.geoid import SD_M, separation_m

# EGM96 on its 15' grid (NGA), at points that are no points of the coarse grid.
PUBLISHED = {
    (41.9, 12.5): 48.48, (47.0, 8.0): 48.39, (0.0, 0.0): 17.16, (90.0, 0.0): 13.61,
}  # fmt: skip


@pytest.mark.parametrize(("place", "height_m"), PUBLISHED.items())
def test_it_is_within_four_of_its_standard_deviations(place: tuple[float, float], height_m: float) -> None:
    assert separation_m(*place) == pytest.approx(height_m, abs=4.0 * SD_M)


def test_it_is_continuous_over_the_antimeridian_and_at_the_poles() -> None:
    for latitude in (-60.0, 1.5, 44.4):
        west, east = separation_m(latitude, -180.0), separation_m(latitude, 179.999999)
        assert west == pytest.approx(east, abs=1e-3) and west == separation_m(latitude, 180.0)
        assert separation_m(latitude, 10.0) == pytest.approx(separation_m(latitude, 370.0))
    assert separation_m(90.0, -100.0) == pytest.approx(separation_m(90.0, 77.0)), "one point, whatever its longitude"
    assert separation_m(-90.0, 3.0) == pytest.approx(separation_m(-90.0, 99.0))


def test_a_latitude_beyond_the_pole_is_refused() -> None:
    with pytest.raises(ValueError, match="latitude"):
        separation_m(90.1, 0.0)
