"""Containers and systemd units hold against the table of processes, and keep what was decided about safety."""

import shutil
import subprocess
from pathlib import Path
from typing import cast

import pytest
import yaml

from broker.keys import CONTAINER_GROUP, CONTAINER_USERS
from cli.demo import supervisor
from shared.bus import bus
from shared.processes import PROCESSES, Kind, ProcessRow, Role, running
from shared.runtime.config import INSTALLED_SOCKET, BrokerAddress
from shared.topics import BY_NAME, hot_path
from tests.support.cases import each
from tests.support.patience import HANGS_S

ROOT = Path(__file__).resolve().parents[2]
SYSTEMD = ROOT / "deploy" / "systemd"
SIMULATED, VEHICLE, ROADSIDE = "docker-compose.yml", "deploy/compose.vehicle.yml", "deploy/compose.rsu.yml"

Service = dict[str, object]
OBU = [row for row in PROCESSES if Role.OBU in row.roles and row.kind is not Kind.REPLAY]
RSU = [row for row in PROCESSES if Role.RSU in row.roles and row.kind is not Kind.REPLAY]
ON_REQUEST = (Kind.DEVICE_DRIVER, Kind.OPTIONAL)  # run where a profile asks for them
# Have a folder of their own in `private`.
PRIVATE_FOLDERS = ("monitoring-status", "monitoring-uplink", "controller-settings")
DEVICES = [row for row in OBU if row.kind is Kind.DEVICE_DRIVER]


FIRST_USER = 10_100
# Users of the containers of all versions, whose files are in the volumes of running units. A line is added with each
# process, and none is changed: a former process keeps its number.
USERS = {
    "sensors.gnss": 10_100,
    "sensors.imu": 10_101,
    "sensors.can": 10_102,
    "sensors.v2x": 10_103,
    "sensors.corrections": 10_104,
    "sensors.power": 10_105,
    "sensors.simulator": 10_106,
    "sensors.plaza": 10_130,
    "controller.settings": 10_131,
    "sensors.traffic": 10_107,
    "sensors.replay": 10_108,
    "parsers.gnss": 10_109,
    "parsers.imu": 10_110,
    "parsers.can": 10_111,
    "parsers.v2x": 10_112,
    "parsers.corrections": 10_113,
    "parsers.power": 10_114,
    "controller.mode": 10_115,
    "controller.cam": 10_116,
    "core.fusion": 10_117,
    "core.motion_conflict": 10_118,
    "core.spoofing": 10_119,
    "core.cooperative": 10_120,
    "core.evidence": 10_121,
    "core.trust": 10_122,
    "core.toll": 10_123,
    "monitoring.ledger": 10_124,
    "monitoring.recorder": 10_125,
    "monitoring.health": 10_126,
    "monitoring.outputs": 10_127,
    "monitoring.status": 10_128,
    "monitoring.uplink": 10_129,
}


class ComposeLoader(yaml.SafeLoader):
    """YAML with the tags of Compose."""


ComposeLoader.add_constructor("!reset", lambda _loader, _node: None)


def services_of(name: str) -> dict[str, Service]:
    document = yaml.load((ROOT / name).read_text(), ComposeLoader)  # the loader is a safe one
    return cast("dict[str, Service]", document["services"])


@pytest.fixture(scope="module")
def simulated() -> dict[str, Service]:
    return services_of(SIMULATED)


@pytest.fixture(scope="module")
def vehicle() -> dict[str, Service]:
    return services_of(VEHICLE)


def container(row: ProcessRow) -> str:
    return row.name.replace(".", "-")


def entry(row: ProcessRow) -> str:
    """Write the container of a process as it stands in its Compose file."""
    anchor = "serial" if row in DEVICES else "hot-path" if row.name in hot_path() else "process"
    profiles = [f"    profiles: [{row.short}]"] if row.kind in ON_REQUEST else []
    user = f'    user: "{CONTAINER_USERS.get(row.name, next_user())}:{CONTAINER_GROUP}"'
    return "\n".join([f"  {container(row)}:", f"    <<: *{anchor}", *profiles, f"    command: [run, {row.name}]", user])


def next_user() -> int:
    """The lowest number that no process has, or had in a release."""
    return max((*USERS.values(), *CONTAINER_USERS.values(), FIRST_USER - 1)) + 1


@each("row", PROCESSES)
def test_the_user_of_a_container_stands_in_the_row_of_its_process_and_stays(row: ProcessRow) -> None:
    wanted = USERS.get(row.name, row.container_user or next_user())
    assert row.container_user == wanted, f"paste into the row of {row.name}:\n\n        container_user={wanted:_},\n"
    assert row.name in USERS, f'paste into USERS of this test:\n\n    "{row.name}": {wanted:_},\n'


def test_no_two_processes_have_the_same_user_of_a_container() -> None:
    owners: dict[int, set[str]] = {}
    for name, user in (*USERS.items(), *CONTAINER_USERS.items()):
        owners.setdefault(user, set()).add(name)
    shared = {user: sorted(names) for user, names in owners.items() if len(names) > 1}
    hint = f"paste into the row of the newer one:\n\n        container_user={next_user():_},\n"
    assert not shared, f"one process could read the files of another: {shared}; {hint}"


@each("row", OBU)
def test_every_process_has_a_container_that_runs_it(row: ProcessRow) -> None:
    file = VEHICLE if row in DEVICES else SIMULATED
    service = services_of(file).get(container(row), {})
    found = (service.get("command"), service.get("profiles"))
    wanted = (["run", row.name], [row.short] if row.kind in ON_REQUEST else None)
    assert found == wanted, f"paste into the services of {file}:\n\n{entry(row)}\n"


@each("row", RSU)
def test_every_process_of_a_road_side_unit_has_a_container_there_with_the_limits_of_another(row: ProcessRow) -> None:
    service = services_of(ROADSIDE).get(container(row), {})
    base = cast("dict[str, str]", service.get("extends", {"file": "", "service": ""}))
    origin = services_of(str((ROOT / "deploy" / base["file"]).resolve().relative_to(ROOT)))[base["service"]]
    assert "extends" not in origin, (
        "Compose seeks the file of a second `extends` from the project's folder, not its own"
    )
    command = service.get("command", origin["command"])
    wanted = f"  {container(row)}:\n    extends: {{file: ../{SIMULATED}, service: core-trust}}\n" \
        f"    environment: *environment\n    command: [run, {row.name}]"  # fmt: skip
    assert command == ["run", row.name], f"paste into the services of {ROADSIDE}:\n\n{wanted}\n"


def test_a_road_side_unit_has_no_other_container_and_reads_its_own_file() -> None:
    services = services_of(ROADSIDE)
    assert services.keys() == {"broker", "keys", *map(container, RSU)}
    files = {name: cast("dict[str, str]", s.get("environment", {})).get("OBU_VEHICLE") for name, s in services.items()}
    assert set(files.values()) == {None, "${OBU_VEHICLE:-deploy/vehicles/rsu.toml}"} and files["broker"] is None
    assert not any("ports" in service or "privileged" in service for service in services.values())


@pytest.mark.parametrize("row", [row for row in OBU if row not in DEVICES], ids=lambda row: row.name)
def test_containers_of_the_hot_path_get_the_processor_first(row: ProcessRow, simulated: dict[str, Service]) -> None:
    first = "cpu_shares" in simulated.get(container(row), {})
    assert first is (row.name in hot_path()), f"in {SIMULATED}, write it as\n\n{entry(row)}\n"


def test_there_is_no_container_besides_them_but_the_broker(
    simulated: dict[str, Service], vehicle: dict[str, Service]
) -> None:
    spare = (simulated.keys() | vehicle.keys()) - {"broker", "keys", *map(container, OBU)}
    assert not spare, f"no process of shared/processes.py runs in {spare}: remove it from {SIMULATED} and {VEHICLE}"


def test_on_a_desk_no_container_needs_a_device(simulated: dict[str, Service]) -> None:
    assert not simulated.keys() & {container(row) for row in DEVICES}


def test_in_a_vehicle_nothing_is_simulated_unless_asked_for(vehicle: dict[str, Service]) -> None:
    for row in OBU:
        if row.kind is Kind.SIMULATOR:
            wanted = f"  {container(row)}:\n    profiles: [{row.short}]\n"
            assert vehicle.get(container(row)) == {"profiles": [row.short]}, f"paste into {VEHICLE}:\n\n{wanted}"


def test_no_container_may_more_than_it_must(simulated: dict[str, Service], vehicle: dict[str, Service]) -> None:
    for name, service in simulated.items():
        assert service["read_only"] is True, name
        assert service["cap_drop"] == ["ALL"], name
        assert service["security_opt"] == ["no-new-privileges:true"], name
        assert service["mem_limit"], name
        assert service["pids_limit"], name
        assert service["logging"], name
        if name == "keys":
            continue
        assert service["restart"] == "unless-stopped", name
        assert service["healthcheck"], name
        assert "cap_add" not in service, name
    for row in DEVICES:
        assert cast("Service", vehicle[container(row)]["extends"])["service"] in simulated
    forbidden = {"privileged", "pid", "ipc", "userns_mode"}
    assert not any(service.keys() & forbidden for services in (simulated, vehicle) for service in services.values())


def test_only_dashboard_and_outputs_publish_ports_and_only_to_this_machine_unless_told(
    simulated: dict[str, Service], vehicle: dict[str, Service]
) -> None:
    assert {name for name, service in simulated.items() if "ports" in service} == {
        "monitoring-status", "monitoring-outputs",
    }  # fmt: skip
    assert not any("ports" in service for service in vehicle.values())
    assert simulated["monitoring-status"]["ports"] == ["${OBU_HTTP_BIND:-127.0.0.1}:${OBU_HTTP_PORT:-8080}:8080"]
    assert simulated["monitoring-outputs"]["ports"] == [
        "${OBU_OUTPUTS_BIND:-127.0.0.1}:${OBU_GPSD_PORT:-2947}:2947",
        "${OBU_OUTPUTS_BIND:-127.0.0.1}:${OBU_NMEA_PORT:-10110}:10110",
    ]


def test_only_dashboard_outputs_and_uplink_reach_beyond_the_bus(simulated: dict[str, Service]) -> None:
    beyond = {name for name, service in simulated.items() if service.get("networks", ["bus"]) != ["bus"]}
    assert beyond == {"monitoring-status", "monitoring-outputs", "monitoring-uplink"}
    document = yaml.load((ROOT / "docker-compose.yml").read_text(), ComposeLoader)
    assert document["networks"]["bus"]["internal"] is True


def test_the_broker_runs_as_mosquitto_with_the_configuration_of_the_repository(simulated: dict[str, Service]) -> None:
    assert simulated["broker"]["user"] == "1883:1883"
    mounted = [str(volume).split(":")[0] for volume in cast("list[object]", simulated["broker"]["volumes"])]
    assert {"./broker/mosquitto.conf", "rules"} <= set(mounted)
    text = (ROOT / "broker" / "mosquitto.conf").read_text()
    assert f"listener 0 {INSTALLED_SOCKET}\n" in text
    assert all((ROOT / path).is_file() for path in mounted if path.startswith("./"))


def test_every_process_reaches_the_broker_by_its_socket(simulated: dict[str, Service]) -> None:
    """Whoever occupies the port keeps none of them out."""
    url, folder = BrokerAddress.at(INSTALLED_SOCKET).url, INSTALLED_SOCKET.parent
    for name, service in simulated.items():
        mode = "" if name in ("keys", "broker") else ":ro"
        assert f"socket:{folder}{mode}" in cast("list[str]", service["volumes"]), name
        if cast("list[str]", service["command"])[:1] == ["run"]:
            assert cast("dict[str, str]", service["environment"])["OBU_BROKER"] == url, name
    for file in (SIMULATED, ROADSIDE):
        assert "socket" in yaml.load((ROOT / file).read_text(), ComposeLoader)["volumes"], file
    made = f"--socket-folder {folder}"
    assert made in " ".join(cast("list[str]", simulated["keys"]["command"]))
    assert f"OBU_BROKER={url} " in (SYSTEMD / "obu@.service").read_text()
    broker = (SYSTEMD / "obu-broker.service").read_text()
    assert f"--broker-user mosquitto --group obu {made}\n" in broker and f"ReadWritePaths=-{folder}\n" in broker


def test_the_maker_of_secrets_ends_before_others_start_and_reaches_nobody(simulated: dict[str, Service]) -> None:
    maker = simulated["keys"]
    assert maker["network_mode"] == "none" and maker["restart"] == "no"
    assert maker["cap_add"] == ["CHOWN", "DAC_OVERRIDE", "FOWNER"], "it gives each secret to its user"
    for name, service in simulated.items():
        if name != "keys":
            assert service["depends_on"] == {"keys": {"condition": "service_completed_successfully"}}, name
            secret = [v for v in cast("list[str]", service["volumes"]) if v.startswith(("private:", "rules:"))]
            assert all(volume.endswith(":ro") for volume in secret) or name in PRIVATE_FOLDERS, name


@pytest.mark.parametrize("file", [SIMULATED, VEHICLE, ROADSIDE])
def test_each_container_has_a_user_of_its_own(file: str) -> None:
    for name, service in services_of(file).items():
        command = cast("list[str]", service.get("command") or [])
        if command[:1] == ["run"]:
            user = f"{CONTAINER_USERS.get(command[1])}:{CONTAINER_GROUP}"
            assert service.get("user") == user, f'paste into {name} of {file}:\n\n    user: "{user}"\n'


def test_each_process_under_systemd_is_given_its_secret_and_a_user_of_its_own() -> None:
    text = (SYSTEMD / "obu@.service").read_text()
    assert "LoadCredential=secret:/var/lib/obu-private/credentials/%i\n" in text and "StateDirectory" not in text
    installer = (SYSTEMD / "install.sh").read_text()
    assert "user=obu-${name//[._]/-}" in installer and "obu@$name.service.d/user.conf" in installer
    names = {f"obu-{row.name.replace('.', '-').replace('_', '-')}" for row in PROCESSES}
    assert len(names) == len(PROCESSES) and max(map(len, names)) <= 32, "names of users on Linux"


def test_the_image_is_not_run_by_root_and_is_built_from_what_the_repository_has() -> None:
    lines = (ROOT / "deploy" / "Dockerfile").read_text().splitlines()
    assert "USER obu" in lines
    copied = [line.split()[1:-1] for line in lines if line.startswith("COPY ") and "--from=" not in line]
    missing = [path for paths in copied for path in paths if not (ROOT / path).exists()]
    assert not missing
    assert {("shared",), ("services",), ("broker",)} <= {tuple(paths) for paths in copied}, "a package is missing"
    given = [line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")]
    paths = [Path(path) for names in copied for path in names]
    assert not [path for path in paths if not any(path.is_relative_to(allowed) for allowed in given)]


@pytest.mark.parametrize("role", Role)
def test_the_target_wants_every_standing_process_of_its_role_and_no_other(role: Role) -> None:
    """The rest is enabled by install.sh where the unit's file has a section for it."""
    text = (SYSTEMD / f"{role}.target").read_text()
    wanted = [word for line in text.splitlines() if line.startswith("Wants=") for word in line[6:].split()]
    units = [word.removeprefix("obu@").removesuffix(".service") for word in wanted if word.startswith("obu@")]
    assert units == [row.name for row in running(role)], "print it anew with `make docs`"
    assert "obu-broker.service" in wanted


def drop_in(name: str, file: str) -> Path:
    return SYSTEMD / f"obu@{name}.service.d" / file


def test_drop_ins_belong_to_processes() -> None:
    names = {folder.name.removeprefix("obu@").removesuffix(".service.d") for folder in SYSTEMD.glob("obu@*.d")}
    spare = names - {row.name for row in PROCESSES}
    assert not spare, f"no process of shared/processes.py has the drop-ins of {spare} in deploy/systemd: remove them"


@each("row", PROCESSES)
def test_the_hot_path_goes_first_and_drivers_reach_their_devices(row: ProcessRow) -> None:
    hot, model = drop_in(row.name, "hot-path.conf"), drop_in("core.fusion", "hot-path.conf")
    if row.name in hot_path():
        to_do = f"mkdir -p '{hot.parent.relative_to(ROOT)}' && cp '{model.relative_to(ROOT)}' '{hot.relative_to(ROOT)}'"
        assert hot.is_file() and hot.read_text() == model.read_text(), (
            f"it is upstream of the solution, so run: {to_do}"
        )
    else:
        assert not hot.exists(), f"it is not upstream of the solution: git rm '{hot.relative_to(ROOT)}'"
    device = drop_in(row.name, "device.conf")
    assert device.exists() or row not in DEVICES, f"write {device.relative_to(ROOT)} after that of sensors.gnss"


def test_the_publisher_of_the_clock_of_the_host_may_read_it_and_not_set_it() -> None:
    (driver,) = [name for name in BY_NAME["host/clock"].producers if "simulator" not in name]
    text = drop_in(driver, "clock.conf").read_text()
    assert "ProtectClock=no\n" in text and "SystemCallFilter=adjtimex clock_adjtime" in text
    assert "CapabilityBoundingSet=\n" in (SYSTEMD / "obu@.service").read_text(), "no CAP_SYS_TIME"


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")
@pytest.mark.parametrize("name", ["obu-broker", "obu-switched", *(f"obu@{row.name}" for row in PROCESSES)])
def test_systemd_understands_every_unit(name: str, tmp_path: Path) -> None:
    shutil.copytree(SYSTEMD, tmp_path / "units")
    result = subprocess.run(
        ["systemd-analyze", "verify", str(tmp_path / "units" / f"{name}.service")],
        env={"SYSTEMD_UNIT_PATH": f"{tmp_path / 'units'}:"}, capture_output=True, text=True, timeout=HANGS_S,
        check=False,
    )  # fmt: skip
    # The installation is not here; systemd before 254 does not know how to wait longer each time.
    expected = ("is not executable", "Unknown key 'RestartSteps'", "Unknown key 'RestartMaxDelaySec'")
    complaints = [line for line in result.stderr.splitlines() if "obu" in line and not any(e in line for e in expected)]
    assert not complaints


def test_udev_understands_the_rules() -> None:
    help_text = ""
    if shutil.which("udevadm"):
        help_text = subprocess.run(["udevadm", "--help"], capture_output=True, text=True, check=False).stdout
    if "verify" not in help_text:
        pytest.skip("this system has no udevadm of systemd 254 or newer")
    rules = ROOT / "deploy" / "udev" / "99-obu.rules"
    result = subprocess.run(["udevadm", "verify", str(rules)], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr


def test_whatever_hangs_is_ended_by_itself_before_it_is_killed_and_runs_again_within_20_s() -> None:
    """By the process itself, which can tell where; by systemd, the demo's supervisor, and a container's shell."""
    kept = {}
    for name in ("obu@", "obu-broker"):
        lines = (SYSTEMD / f"{name}.service").read_text().splitlines()
        kept[name] = dict(line.split("=", 1) for line in lines if "=" in line and not line.startswith("#"))
        assert kept[name]["Type"] == "notify" and kept[name]["WatchdogSignal"] == "SIGKILL"
    container = (ROOT / "deploy" / "supervise.sh").read_text()
    assert f"limit_s={round(supervisor.HUNG_S)}\n" in container and "limit_s=90\n" in container
    for killed_s in (supervisor.HUNG_S, *(float(keys["WatchdogSec"]) for keys in kept.values())):
        assert killed_s > bus.HUNG_S, "the own watchdog comes first, and leaves a traceback"
        assert killed_s + float(kept["obu@"]["RestartSec"]) + 5.0 <= 20.0, "5 s for the start of a process"
    assert 'ENTRYPOINT ["sh", "deploy/supervise.sh",' in (ROOT / "deploy" / "Dockerfile").read_text()
    assert services_of(SIMULATED)["broker"]["environment"] == {"OBU_BROKER_WATCH": "1"}
