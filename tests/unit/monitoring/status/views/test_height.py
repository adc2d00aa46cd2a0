"""Height above mean sea level does not step with what single fixes state."""

from services.monitoring.status.views.models.position import Solution
from services.monitoring.status.views.position import solution as shown
from shared.maths.geoid.geoid import separation_m
from tests.support.dashboard.status_world import World, fix, solution


def heard(world: World, **heights: float | None) -> Solution:
    world.hear(fix(world.now_ns, **heights), "parsers.gnss")
    world.hear(solution(world.now_ns, height_ellipsoid_m=520.0), "core.fusion")
    return shown(world.state, world.now_ns)


def test_a_fix_without_heights_changes_nothing() -> None:
    world, grid_m = World(), separation_m(48.0, 11.0)
    first = heard(world)
    assert first["geoid"] == "grid" and first["height_msl_m"] == round(520.0 - grid_m, 3)
    stated = heard(world, height_ellipsoid_m=500.0, height_msl_m=500.0 - grid_m - 2.0)
    assert stated["geoid"] == "receiver" and stated["height_msl_m"] == round(520.0 - grid_m - 2.0, 3)
    for heights in ({}, {"height_ellipsoid_m": 500.0}, {"height_ellipsoid_m": 500.0, "height_msl_m": 500.0}):
        assert heard(world, **heights)["height_msl_m"] == stated["height_msl_m"], "none, half, and one that cannot be"


def test_a_separation_that_cannot_be_is_not_believed() -> None:
    for height_msl_m in (500.0, 0.0, 9_000.0):
        assert heard(World(), height_ellipsoid_m=500.0, height_msl_m=height_msl_m)["geoid"] == "grid"
