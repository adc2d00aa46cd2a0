"""What the page Toll says of the vehicles before the plaza."""

from services.core.toll.codes import Code
from services.monitoring.status.views import toll
from shared.messages.toll import TollTracks
from shared.messages.v2x import Authentication, Unverified
from shared.words.words import LANGUAGES
from tests.support.dashboard.status_world import World
from tests.support.v2x.fake_plaza import VEHICLE_TOML, FakePlaza
from tests.support.v2x.tolling import PLAZA


def test_what_was_checked_of_a_sender_is_said_in_every_language() -> None:
    world, fake = World(VEHICLE_TOML), FakePlaza()
    fake.started_ns = world.now_ns
    for producer, message in fake._tracks(world.now_ns):
        assert isinstance(message, TollTracks)
        world.hear(message, producer)
    world.hear(PLAZA.description(world.now_ns), "core.toll")
    shown = toll.plaza(world.state, world.now_ns)
    assert shown is not None
    assert [(track["authentication"], track["verified"]) for track in shown["tracks"]] == [
        ("authenticated: signature, ticket and its chain to a trusted root", True),
        ("signed, not verified: issued by an authority that is not trusted", False),
        ("signed, not verified", False),
        ("unsigned", False),
    ]
    assert shown["tracks"][2]["languages"] == {"de": "signiert, nicht geprüft", "fr": "signé, non vérifié"}
    assert all(set(track["languages"]) == set(LANGUAGES) - {"en"} for track in shown["tracks"])


def test_every_state_of_a_signature_has_a_code() -> None:
    assert {f"toll.{state}" for state in (*Authentication, *Unverified)} <= set(Code)
