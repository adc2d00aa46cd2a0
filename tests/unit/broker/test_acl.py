"""The access list: its format, and the printed list against the rows of the contract."""

import itertools

import pytest
from paho.mqtt.client import topic_matches_sub

from broker.acl import access_list
from broker.simulated import AclError, parse
from shared.processes import PROCESSES, ProcessRow
from shared.programs import ROLES
from shared.runtime.credentials import OBSERVERS
from shared.topics import SETTINGS, TOPICS, may_send
from tests.support.cases import each

NAMES = [row.name for row in PROCESSES]
PRINTED = parse(access_list())


@each("row", PROCESSES)
def test_a_process_may_read_and_write_the_topics_of_its_row_only(row: ProcessRow) -> None:
    for topic, owner in itertools.product(TOPICS, NAMES):
        name = "obu/any-vehicle/" + topic.name.replace("+", owner)
        asked = any(topic_matches_sub(pattern, topic.name) for pattern in (*row.on_request, SETTINGS))
        reads = row.observes_all or row.name in topic.consumers or asked
        writes = row.name in topic.producers and (not topic.per_process or owner == row.name)
        assert PRINTED.may_read(row.name, name) is reads
        assert PRINTED.may_write(row.name, name) is writes


@pytest.mark.parametrize("user", [None, "unknown", "core"])
def test_an_unknown_user_may_neither_read_nor_write(user: str | None) -> None:
    assert not PRINTED.may_subscribe(user, "#")
    assert not PRINTED.may_write(user, "obu/v/gnss/raw")


def test_an_observer_reads_everything_and_writes_nothing() -> None:
    names = ["obu/v/" + topic.name.replace("+", "core.fusion") for topic in TOPICS]
    for observer in OBSERVERS:
        assert all(PRINTED.may_read(observer, name) for name in names)
        assert not any(PRINTED.may_write(observer, name) for name in names)


def test_the_access_list_can_be_limited_to_one_vehicle() -> None:
    acl = parse(access_list("car-7"))
    assert acl.may_write("core.fusion", "obu/car-7/navigation/solution")
    assert not acl.may_write("core.fusion", "obu/car-8/navigation/solution")


def test_anonymous_clients_may_be_allowed_to_read() -> None:
    acl = parse(access_list(nameless_read=True))
    assert acl.may_read(None, "obu/v/navigation/solution")
    assert not acl.may_write(None, "obu/v/navigation/solution")
    assert not acl.may_read("unknown", "obu/v/navigation/solution")


def test_topic_lines_have_the_meaning_of_mosquitto() -> None:
    acl = parse("topic read all/#\n\n# a comment\nuser a b\ntopic mine/#\ntopic deny mine/secret\ntopic write read\n")
    assert acl.may_read(None, "all/x")
    assert not acl.may_read("a b", "all/x")
    assert acl.may_write("a b", "mine/x")
    assert acl.may_read("a b", "mine/x")
    assert not acl.may_read("a b", "mine/secret")
    assert acl.may_write("a b", "read")


@pytest.mark.parametrize("line", ["pattern read %c/#", "user", "topic", "topic read a/#/b", "password x"])
def test_an_invalid_line_is_named_in_the_error(line: str) -> None:
    with pytest.raises(AclError, match="line 2"):
        parse(f"user a\n{line}\n")


@pytest.mark.parametrize("role", ["operator", "detector"])
def test_a_program_writes_the_topics_of_its_role_and_no_others(role: str) -> None:
    rules = parse(access_list("plaza", programs={"office": role}))
    rights = ROLES[role]
    for topic in TOPICS:
        name = f"obu/plaza/{topic.name.replace('+', 'core.toll')}"
        assert rules.may_write("office", name) is (topic.name in rights.writes)
        assert rules.may_read("office", name) is (topic.name in rights.reads)
        assert may_send(role, topic.name.replace("+", "core.toll")) is (topic.name in rights.writes)


def test_each_way_in_of_a_real_plaza_has_a_role_that_writes_it() -> None:
    """Without the simulator, which publishes them too."""
    written = {name for rights in ROLES.values() for name in rights.writes}
    assert {"toll/registration", "toll/receipt", "toll/paid_otherwise", "plaza/detector"} <= written
