"""The broker's files say what the code says."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from broker import local_config
from broker.acl import access_list
from broker.simulated import Limits
from shared.topics import TOPICS, Topic
from tests.support.cases import each
from tests.support.patience import HANGS_S

ROOT = Path(__file__).parents[2]
LOCAL = local_config.configuration(18_830, Path("/data"), Path("/rules"))
LISTENING = local_config.configuration(18_830, Path("/data"), Path("/rules"), "0.0.0.0", Path("/state/bus/socket"))


def setting(name: str) -> str:
    found = re.findall(rf"^{name} (.*)$", (ROOT / "broker" / "mosquitto.conf").read_text(), re.MULTILINE)
    assert len(found) == 1, f"{name} stands {len(found)} times in broker/mosquitto.conf"
    return str(found[0])


def test_the_command_prints_the_access_list() -> None:
    command = [sys.executable, "-m", "broker.acl", "--vehicle", "car-7"]
    printed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True, timeout=HANGS_S).stdout
    assert printed == access_list("car-7")


def test_both_brokers_have_the_same_bounds() -> None:
    limits = Limits()
    assert int(setting("max_packet_size")) == limits.packet_bytes
    text = (ROOT / "broker" / "mosquitto.conf").read_text()
    assert set(re.findall(r"^max_connections (.*)$", text, re.MULTILINE)) == {str(limits.connections)}
    assert int(setting("max_queued_messages")) == limits.queue_messages
    assert int(setting("max_queued_bytes")) == limits.queue_bytes
    assert int(setting("max_inflight_messages")) == limits.in_flight


@pytest.mark.parametrize("text", [(ROOT / "broker" / "mosquitto.conf").read_text(), LOCAL, LISTENING])
def test_unfinished_packets_on_every_connection_take_half_of_the_memory_at_most(text: str) -> None:
    def settings(name: str) -> list[int]:
        return [int(value) for value in re.findall(rf"^{name} (\d+)$", text, re.MULTILINE)]

    listeners = re.findall(r"^listener ", text, re.MULTILINE)
    assert len(settings("max_connections")) == len(listeners), "a listener without a limit"
    (packet,), (memory,) = settings("max_packet_size"), settings("memory_limit")
    assert sum(settings("max_connections")) * packet <= memory // 2


@each("topic", TOPICS)
def test_the_largest_message_of_a_topic_fits_into_a_packet(topic: Topic) -> None:
    assert topic.most_bytes + 16_384 <= int(setting("max_packet_size"))


def test_mosquitto_sends_small_messages_at_once_and_offers_no_websockets() -> None:
    assert setting("set_tcp_nodelay") == "true"
    text = (ROOT / "broker" / "mosquitto.conf").read_text()
    assert not re.search(r"^protocol ", text, re.MULTILINE)


@pytest.mark.parametrize("text", [(ROOT / "broker" / "mosquitto.conf").read_text(), LOCAL])
def test_the_listener_comes_first_for_otherwise_mosquitto_opens_another_on_every_address(text: str) -> None:
    options = [line.split(" ")[0] for line in text.splitlines() if line and not line.startswith("#")]
    assert options[0] == "listener"


def test_the_local_configuration_differs_in_its_places_only() -> None:
    printed = LOCAL.splitlines()
    original = (ROOT / "broker" / "mosquitto.conf").read_text().splitlines()
    added = {line for line in printed if line and not line.startswith("#") and line not in original}
    removed = {line for line in original if line not in printed and not line.startswith("#")}
    assert added == {
        "listener 18830 127.0.0.1",
        "socket_domain ipv4",
        "persistence_location /data/",
        "password_file /rules/passwords",
        "acl_file /rules/acl.conf",
        "log_dest stderr",
    }
    assert {line.split(" ")[0] for line in removed} == {
        "listener", "persistence_location", "password_file", "acl_file", "log_dest"
    }  # fmt: skip
