"""Secrets of a unit and the broker's files: made once, kept, readable by their owner alone."""

import os
import socket
import stat
from pathlib import Path

import pytest

from broker import keys
from broker.keys import KeyFileOwners, make
from broker.passwords import Passwords
from broker.simulated import parse
from shared.errors import UserError
from shared.evidence import KeyFile
from shared.runtime.config import VehicleFile, parse_vehicle
from shared.runtime.credentials import CHECK, OBSERVERS, WATCH
from shared.topics import REPLAY

CAR = parse_vehicle('[vehicle]\nname = "car"\n\n[sensors.gnss]\n')


def made(folder: Path, vehicle: VehicleFile = CAR) -> tuple[dict[str, str], Passwords, str]:
    passwords, rules = make(folder / "credentials", vehicle, KeyFileOwners(vehicle.path, str(folder / "rules")))
    secrets = {p.name: p.read_text().strip() for p in (folder / "credentials").iterdir() if p.name != keys.MADE}
    return secrets, Passwords(passwords.read_text()), rules.read_text()


def test_each_process_of_the_vehicle_has_a_secret_of_its_own_that_nobody_else_reads(tmp_path: Path) -> None:
    secrets, known, _ = made(tmp_path)
    assert set(secrets) == {row.name for row in keys.rows_of(CAR)} | set(OBSERVERS)
    assert len(set(secrets.values())) == len(secrets) and {len(s) for s in secrets.values()} == {64}
    assert all(known.matches(name, secret) for name, secret in secrets.items())
    for path in (tmp_path / "credentials").iterdir():
        assert stat.S_IMODE(path.stat().st_mode) in (0o400, 0o600), path
    assert stat.S_IMODE((tmp_path / "credentials").stat().st_mode) == 0o700
    for name in (WATCH, CHECK):
        assert known.matches(name, (tmp_path / "rules" / name).read_text().strip())


def test_a_second_start_keeps_what_is_there_and_mends_what_a_power_cut_left(tmp_path: Path) -> None:
    secrets, _, _ = made(tmp_path)
    text = (tmp_path / "rules" / keys.PASSWORDS).read_text()
    assert made(tmp_path)[0] == secrets
    assert (tmp_path / "rules" / keys.PASSWORDS).read_text() == text
    cut = tmp_path / "credentials" / "core.fusion"
    cut.chmod(0o600)
    cut.write_text("")
    again, known, _ = made(tmp_path)
    assert len(again["core.fusion"]) == 64 and known.matches("core.fusion", again["core.fusion"])
    assert again | {"core.fusion": ""} == secrets | {"core.fusion": ""}


def test_the_access_list_is_of_this_vehicle_and_its_processes_alone(tmp_path: Path) -> None:
    _, known, rules = made(tmp_path)
    rights = parse(rules)
    assert rights.may_write("core.fusion", "obu/car/navigation/solution")
    assert not rights.may_write("core.fusion", "obu/other/navigation/solution")
    assert not any(rights.may_write("sensors.simulator", f"obu/car/{name}") for name in ("gnss/raw", "imu/raw"))
    assert not known.lines.keys() & {"sensors.simulator", "sensors.replay", "core.toll", REPLAY}
    assert all(line.count("+") == 0 or line.startswith("topic read") for line in rules.splitlines())


def test_a_recording_is_played_only_into_a_unit_without_sensors(tmp_path: Path) -> None:
    bench = parse_vehicle('[vehicle]\nname = "bench"\n')
    secrets, _, rules = made(tmp_path, bench)
    assert REPLAY in secrets and parse(rules).may_write(REPLAY, "obu/bench/gnss/raw")


def test_a_further_user_reads_everything_and_is_kept(tmp_path: Path) -> None:
    made(tmp_path)
    secret = keys.add_program(tmp_path / "credentials", "gateway")
    _, known, rules = made_again(tmp_path)
    assert known.matches("gateway", secret)
    assert parse(rules).may_read("gateway", "obu/car/navigation/solution")
    assert not parse(rules).may_write("gateway", "obu/car/navigation/solution")
    keys.remove_program(tmp_path / "credentials", "gateway")
    assert not made_again(tmp_path)[1].matches("gateway", secret)


def made_again(folder: Path) -> tuple[None, Passwords, str]:
    passwords, rules = make(folder / "credentials", CAR, keys.made_in(folder / "credentials"))
    return None, Passwords(passwords.read_text()), rules.read_text()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a folder to another user")
def test_secrets_in_a_folder_of_another_user_are_not_used(tmp_path: Path) -> None:
    (tmp_path / "credentials").mkdir()
    os.chown(tmp_path / "credentials", 12_345, -1)
    with pytest.raises(UserError, match="another user's"):
        made(tmp_path)


def test_a_link_in_place_of_the_folder_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "credentials").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(UserError):
        made(tmp_path)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files to other users")
def test_in_containers_each_secret_is_given_to_the_user_of_its_container(tmp_path: Path) -> None:
    folder = tmp_path / "credentials"
    make(folder, CAR, KeyFileOwners(CAR.path, str(tmp_path / "rules"), str(keys.CONTAINER_BROKER), containers=True))
    for name, user in keys.CONTAINER_USERS.items():
        if (folder / name).exists():
            found = (folder / name).stat()
            assert (found.st_uid, stat.S_IMODE(found.st_mode)) == (user, 0o400), name
    for name in (keys.PASSWORDS, keys.ACCESS_LIST, WATCH, CHECK):
        assert (tmp_path / "rules" / name).stat().st_uid == keys.CONTAINER_BROKER


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files to a group")
def test_the_state_of_an_earlier_version_is_shared_once_and_no_link_is_followed(tmp_path: Path) -> None:
    state, outside = tmp_path / "state", tmp_path / "outside"
    (state / "recordings").mkdir(parents=True, mode=0o700)
    (state / "recordings" / "drive.mcap").touch(0o600)
    outside.mkdir(mode=0o700)
    (outside / "secret").touch(0o600)
    (state / "link").symlink_to(outside / "secret")
    (state / "folder").symlink_to(outside)
    (state / "hard").hardlink_to(outside / "secret")
    os.mkfifo(state / "fifo", 0o600)
    keys.share(state, 12_345)
    found = (state / "recordings" / "drive.mcap").stat()
    assert (found.st_gid, stat.S_IMODE(found.st_mode)) == (12_345, 0o660)
    assert stat.S_IMODE((state / "recordings").stat().st_mode) == 0o2770
    for path, mode in ((outside, 0o700), (outside / "secret", 0o600), (state / "fifo", 0o600)):
        assert (path.stat().st_gid, stat.S_IMODE(path.stat().st_mode)) == (0, mode), path
    (state / "later").touch(0o600)
    keys.share(state, 12_345)
    assert stat.S_IMODE((state / "later").stat().st_mode) == 0o600, (
        "it is shared already: its group may have changed it"
    )


OWNERS = {"page": 12_346, "uplink": 12_348, "settings": 12_349}


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files to other users")
def test_tokens_are_the_pages_and_the_key_that_signs_is_of_those_who_sign(tmp_path: Path) -> None:
    for _ in range(2):
        keys.separate(tmp_path, OWNERS, 12_350, 12_347)
        page, key = tmp_path / "page", tmp_path / "keys" / "evidence.key"
        assert (page.stat().st_uid, stat.S_IMODE(page.stat().st_mode)) == (12_346, 0o700)
        uplink = tmp_path / "uplink"
        assert (uplink.stat().st_uid, stat.S_IMODE(uplink.stat().st_mode)) == (12_348, 0o700)
        settings = (tmp_path / "settings").stat()
        assert (settings.st_uid, settings.st_gid, stat.S_IMODE(settings.st_mode)) == (12_349, 12_350, 0o750)
        assert (key.stat().st_uid, key.stat().st_gid, stat.S_IMODE(key.stat().st_mode)) == (0, 12_347, 0o440)
        assert stat.S_IMODE(key.parent.stat().st_mode) == 0o750
    before = KeyFile(tmp_path / "keys").signer().key_id
    KeyFile(tmp_path / "keys").rotate(1)
    assert (key.stat().st_gid, stat.S_IMODE(key.stat().st_mode)) == (12_347, 0o440)
    assert KeyFile(tmp_path / "keys").ring.find(before) is not None


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files to other users")
@pytest.mark.parametrize("name", ["page", "uplink", "settings", "keys"])
def test_a_link_in_place_of_a_folder_of_root_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "file").touch(0o600)
    (tmp_path / "private").mkdir()
    (tmp_path / "private" / name).symlink_to(tmp_path / "elsewhere")
    with pytest.raises(UserError, match="remove it"):
        keys.separate(tmp_path / "private", OWNERS, 12_350, 12_347)
    assert (tmp_path / "elsewhere" / "file").stat().st_uid == 0


@pytest.mark.parametrize("mode", [0o777, 0o770, 0o702])
def test_secrets_that_others_may_write_are_not_used(tmp_path: Path, mode: int) -> None:
    made(tmp_path)
    (tmp_path / "credentials").chmod(mode)
    with pytest.raises(UserError, match="others may write"):
        made(tmp_path)
    with pytest.raises(UserError, match="others may write"):
        keys.made_in(tmp_path / "credentials")


def test_left_overs_of_a_write_are_no_users(tmp_path: Path) -> None:
    made(tmp_path)
    keys.add_program(tmp_path / "credentials", "gateway")
    (tmp_path / "credentials" / "readers" / ".eve.part").write_text("a" * 64)
    assert set(made_again(tmp_path)[1].lines) & {"gateway", ".eve.part"} == {"gateway"}


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives a folder to others")
def test_the_folder_of_the_socket_is_of_the_broker_and_its_group_may_enter_alone(tmp_path: Path) -> None:
    folder = tmp_path / "run" / "obu-broker"
    for _ in range(2):  # at each start of the broker
        keys.share_socket(folder, 1_883, 12_345)
        found = folder.stat()
        assert (found.st_uid, found.st_gid, stat.S_IMODE(found.st_mode)) == (1_883, 12_345, 0o2750)
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(folder / "socket"))
    assert (folder / "socket").stat().st_gid == 12_345, "the socket has the group of its folder"
    (tmp_path / "link").symlink_to(folder)
    with pytest.raises(UserError, match="cannot make the folder"):
        keys.share_socket(tmp_path / "link", 0, 0)
