"""What is printed from code: the pages of docs/reference, and parts of other files."""

import inspect
import json
from collections.abc import Iterator
from pathlib import Path
from typing import cast

from services.monitoring.status.web.access.rights import GRANTED, MEANING, Right
from services.monitoring.status.web.access.table import ROWS
from services.monitoring.status.web.routes import openapi
from shared.attacks import ATTACKS, Parameter
from shared.bus.contract import Json, processes_table, table, topics_table
from shared.errors import UserError
from shared.messages.trust import TrustLevel
from shared.missing_sensors import MISSING_COMBINATIONS
from shared.processes import PROCESSES, Role, running
from shared.protocols.registry import PROTOCOLS
from shared.rejects import PARTS
from shared.runtime.config import Section, Vehicle, own_fields, settings_model
from shared.words.words import PLACEHOLDER, words

from ..papers.coverage.page import coverage_page
from ..schemas import schemas_page
from ..solve.metrics.metrics import METRICS, TIMINGS
from ..solve.smoothing import SMOOTHED_METRICS
from ..solve.track import COLUMNS
from .picture import picture
from .wrap import wrap

BEGIN, END = "begin of what `make docs` prints", "end of what `make docs` prints"
FAST = (
    "Each topic is `obu/<vehicle>/` and the name below. Of a *fast* one the heartbeats tell how much was sent and "
    "received (`published`, `received` of `health/+`). `obu topics` prints the table, `obu tail TOPIC` live messages."
)
HEAD = "<!-- Printed from code by `make docs`; a test holds it to the code. -->\n\n"


def configuration_pages() -> str:
    """Print every setting of every process."""
    parts = [*_tables("vehicle", Vehicle)]
    for row in PROCESSES:
        config = settings_model(row.name)
        parts += _tables(row.name, config)
    return "\n".join(parts)


def _tables(name: str, config: type[Section], said: str = "") -> Iterator[str]:
    """Print one table for a section, below what it is about, then one for each section inside it."""
    own = own_fields(config)
    inner = {
        key: field.annotation
        for key, field in own.items()
        if isinstance(field.annotation, type) and issubclass(field.annotation, Section)
    }
    fields = cast("dict[str, Json]", config.model_json_schema().get("properties", {}))
    rows = [
        (
            f"`{key}`",
            _kind(field),
            f"`{json.dumps(field.get('default'))}`",
            str(field.get("description", "")),
        )
        for key, field in fields.items()
        if key in own and key not in inner
    ]
    body = table(("setting", "type", "default", "meaning"), rows) if rows else "No settings."
    yield f"## [{name}]\n\n{said}{body}\n"
    for key, section in inner.items():
        yield from _tables(f"{name}.{key}", section, f"{inspect.getdoc(section)}\n\n")


def metrics_page() -> str:
    """Print what `obu solve` writes: the metrics, and the columns of solution.csv."""
    metrics = table(("name", "meaning"), [(f"`{name}`", meaning) for name, meaning in METRICS.items()])
    smoothed = table(("name", "meaning"), [(f"`{name}`", meaning) for name, meaning in SMOOTHED_METRICS.items()])
    timings = table(("name", "meaning"), [(f"`{name}`", meaning) for name, meaning in TIMINGS.items()])
    stamps = [
        ("`sampled_ns`", "time of validity on the time line of the recording, ns"),
        ("`time_s`", "time since the first row"),
        (
            "`phase`",
            "`navigating`, `coasting` if no position was used recently, or `gnss_only` without inertial samples",
        ),
    ]
    verdict = ("`verdict`", "verdict of `core.trust`: " + ", ".join(f"`{level}`" for level in TrustLevel))
    columns = table(
        ("column", "meaning"), [*stamps, *((f"`{name}`", meaning) for name, meaning in COLUMNS.items()), verdict]
    )
    return (
        "# What `obu solve` writes\n\n"
        "Names end in their unit (see [conventions](conventions.md)). An unknown metric is `null`.\n\n"
        f"## metrics.json\n\n`verdict` is the sentence with which the report begins.\n\n{metrics}\n\n"
        "A name with a dot is a key of an object: `trust_seconds` holds `safe`, `caution`, ... With `--without trust` "
        "everything from `trust_seconds` on is `null`.\n\n"
        "Root mean squares and percentiles are computed over the times of the truth while the filter navigates or "
        "coasts, outages included.\n\n"
        f"`--smooth` adds:\n\n{smoothed}\n\n"
        f"## Times, printed only\n\nThese differ from run to run and are not written to a file.\n\n{timings}\n\n"
        f"## solution.csv\n\nOne row per solution while the filter navigates or coasts.\n\n{columns}\n\n"
        "`solution_smoothed.csv`, of `--smooth`, has the same columns: one row per period of the solution, at the "
        "steps of the covariance propagation and therefore not at the stamps of solution.csv; phase, standstill and "
        "age of GNSS are those of the filter, and columns without a smoothed value are empty.\n\n"
        "## A truth of your own\n\n"
        "`--truth FILE` reads a CSV file with columns of these names: `sampled_ns`, or `utc_s` in seconds since 1970 "
        "(brought to the unit's time line by the UTC of its fixes), and any of position (`latitude_deg`, "
        "`longitude_deg`, `height_ellipsoid_m`), velocity (`velocity_north_m_s`, `velocity_east_m_s`, "
        "`velocity_down_m_s`) and attitude (`roll_rad`, `pitch_rad`, `yaw_rad`). They refer "
        "to the IMU. A solution.csv or solution_smoothed.csv of another run is such a file.\n"
    )


def attacks_page() -> str:
    """Print the attacks of the simulator with their parameters."""
    rows = [
        (
            f"`{row.name}`", row.purpose, " or ".join((row.accused or "nobody", *row.also)),
            "<br>".join(_parameter(parameter) for parameter in row.parameters) or "none",
        )
        for row in ATTACKS
    ]  # fmt: skip
    return (
        "# Attacks\n\n"
        "`obu demo --attack`, `obu attack-lab --attack`, the page *Trust* and `simulation/attack` start them. The "
        "notation is `name(parameter=value,...)@start:duration` in seconds; parameters may be shortened. "
        "[The simulator](../explanation/simulator.md#attacks) describes what each makes of the messages.\n\n"
        f"{table(('attack', 'what happens', 'a monitor should suspect', 'parameters: default, limits'), rows)}\n"
    )


def _parameter(one: Parameter) -> str:
    limits = f"{one.default:g} ({one.least:g} to {one.greatest:g})"
    return f"`{one.name}` {limits}{f' {one.unit}' if one.unit else ''}: {one.purpose}"


def rejects_page() -> str:
    """Print every reason of a reject, and the protocols that are recognised."""
    protocols = [
        (protocol.title, ", ".join(sorted(protocol.read_at)) or "not decoded", protocol.remedy)
        for protocol in PROTOCOLS
    ]
    parts = [
        "# Why a message was rejected\n\n"
        "A message that cannot be used is counted by its reason: `obu doctor`, the page *System* and `health/+` state "
        "reasons and counts. A `*` stands for any text.\n"
    ]
    for title, reasons in PARTS.items():
        rows = [(f"`{kind}`", reason.meaning, reason.remedy) for kind, reason in reasons.items()]
        parts.append(f"\n## {title}\n\n{table(('reason', 'meaning', 'what to do'), rows)}\n")
    known = table(("protocol", "read at", "what to switch on in its place"), protocols)
    parts.append(
        "\n## Protocols that are recognised\n\nBy their bytes, at any rate of a port; `obu doctor --probe` names what "
        f"it finds. Ports: `gnss`, `imu` and `can` of `[sensors]`, and sources of corrections.\n\n{known}\n"
    )
    return "".join(parts)


def missing_page() -> str:
    """Print what is published while a sensor is missing."""
    rows = [
        (
            row.sensors, row.published, row.uncertainty, " → ".join(f"`{phase}`" for phase in row.phases),
            " → ".join(level.upper() for level in row.verdicts), _form(row.code), row.cost,
        )
        for row in MISSING_COMBINATIONS
    ]  # fmt: skip
    head = ("missing", "published", "covariance and level", "phase", "verdict", "its reason", "what it costs")
    return (
        "# Missing sensors\n\n"
        "Any one sensor may be missing; everything else goes on. The page *System*, `mode/state` and the reasons of "
        "`trust/state` name what is missing. Every row but the first two is held by "
        "`tests/scenarios/test_missing_sensors.py`.\n\n"
        f"{table(head, rows)}\n\n"
        "Of several receivers, inertial units or speeds `controller.mode` selects one (`gnss_source`, `imu_source`, "
        "`speed_source` of `mode/state`), and every process uses it. Another one is selected when the selected one has "
        "sent no valid message for 3 s, when another receiver states less than half of its standard deviation for "
        "10 s, or by `obu command select_source`; `switches` lists the newest changes with their reasons. UBX and NMEA "
        "of one receiver are one receiver, of which UBX is preferred.\n"
    )


def _form(code: str) -> str:
    """Words of a code with its values left out."""
    return PLACEHOLDER.sub("...", words().row(code).detail)


def access_page() -> str:
    """Print the roles, and which route needs which."""
    meaning = {
        Right.PUBLIC: MEANING[Right.PUBLIC],
        **{right: f"a token or session: {MEANING[right]}" for right in GRANTED},
    }
    roles = table(("role", "meaning"), [(f"`{right}`", text) for right, text in meaning.items()])
    rows = [(f"`{row.method} {row.path}`", f"`{row.right}`", row.purpose) for row in ROWS]
    return (
        "# Roles of the page\n\n"
        "Each role includes those before it. `obu token add NAME --role ROLE` makes a token, "
        "[Let others look](../how-to/let-others-look.md) describes the login.\n\n"
        f"{roles}\n\n"
        "A unit without devices needs no login from its own machine: who asks there has the role `admin`.\n\n"
        "## Routes\n\n"
        "The server decides by this table. HEAD needs what GET needs; a change that is not listed needs `admin`, and "
        "has no route. `POST` needs the header `X-OBU-CSRF` with the value of `/api/session`, or a token in the header "
        "`Authorization`.\n\n"
        f"{table(('route', 'role', 'what it does'), rows)}\n"
    )


def api_page(description: Json) -> str:
    """Print the routes of the unit's web server."""
    tags = {tag["name"]: tag["description"] for tag in cast("list[dict[str, str]]", description["tags"])}
    routes = cast("dict[str, dict[str, dict[str, Json]]]", description["paths"])
    parts = [
        "# API\n\n",
        f"{cast('Json', description['info'])['description']} `/docs` of a unit shows the same with forms to try, "
        "`/openapi.json` and `obu schemas api` are the description for programs, and [Read the unit from a program]"
        "(../how-to/read-the-unit-from-a-program.md) has examples.\n",
    ]
    for tag, about in tags.items():
        rows = [
            (f"`{method.upper()} {path}`", str(route["description"]).replace("\n", " "), _answers(route))
            for path, methods in routes.items()
            for method, route in methods.items()
            if tag in cast("list[str]", route["tags"])
        ]
        parts.append(f"\n## {tag.capitalize()}\n\n{about}.\n\n{table(('route', 'answer', 'types'), rows)}\n")
    parts.append(
        "\n## WebSocket\n\n`/ws` sends a snapshot (`kind: snapshot`), then five times a second what changed "
        "(`kind: difference`): objects in `state` merge into what was sent before, everything else replaces it, and "
        "`removed` lists the keys to delete, each as the path to it; a key that holds null stays. `sequence` counts "
        "by one; who misses one connects again. `/ws?packed=1` sends the same as binary messages in zlib's format, "
        "each complete in itself.\n"
    )
    return "".join(parts)


def _answers(route: dict[str, Json]) -> str:
    """Name the media types of the good answer."""
    answers = cast("dict[str, dict[str, dict[str, Json]]]", route["responses"])
    good = next(answer for status, answer in answers.items() if status in ("200", "202"))
    return ", ".join(f"`{kind}`" for kind in good["content"])


def pages() -> dict[str, str]:
    """Make every page of docs/reference that is printed from code: file name and text."""
    return {
        "topics.md": f"{HEAD}# Topics\n\n{FAST}\n\n{topics_table()}\n",
        "processes.md": f"{HEAD}# Processes\n\n`obu run NAME` runs one of them.\n\n{processes_table()}\n",
        "configuration.md": f"{HEAD}# Configuration\n\nOne TOML file per vehicle, one section per process; "
        "`[vehicle]` holds what several of them need. `obu migrate FILE` rewrites a file of an earlier version."
        f"\n\n{configuration_pages()}",
        "metrics.md": HEAD + metrics_page(),
        "missing-sensors.md": HEAD + missing_page(),
        "attacks.md": HEAD + attacks_page(),
        "rejects.md": HEAD + rejects_page(),
        "access.md": HEAD + access_page(),
        "api.md": HEAD + api_page(cast("Json", openapi())),
        "schemas.md": HEAD + schemas_page(),
        "papers.md": HEAD + coverage_page(),
    }


def blocks() -> dict[str, str]:
    """Make what is printed between two markers of files that are otherwise written by hand: path and text."""
    return {f"deploy/systemd/{role}.target": _wants(role) for role in Role}


def _wants(role: Role) -> str:
    """List the standing processes of a role as units of systemd, one line a layer."""
    layers = ([row for row in running(role) if row.layer == n] for n in range(1, 6))
    return "".join(f"Wants={' '.join(f'obu@{row.name}.service' for row in rows)}\n" for rows in layers if rows)


def printed(root: Path) -> dict[Path, str]:
    """Make every file of the repository that is printed from code, wholly or between its markers."""
    files = {root / "docs" / "reference" / name: wrap(text) for name, text in pages().items()}
    files[root / "docs" / "architecture.svg"] = picture()
    for name, text in blocks().items():
        lines = (root / name).read_text(encoding="utf-8").splitlines(keepends=True)
        begin, end = (next(n for n, line in enumerate(lines) if mark in line) for mark in (BEGIN, END))
        files[root / name] = "".join([*lines[: begin + 1], text, *lines[end:]])
    return files


def write(root: Path) -> list[Path]:
    """Write what is printed into the repository; raises `UserError` for another folder."""
    if not (root / "docs" / "reference").is_dir():
        raise UserError(f"{root.resolve()} is not the repository; run this there, or name its folder")
    files = printed(root)
    for path, text in files.items():
        path.write_text(text, encoding="utf-8")
    return list(files)


def _kind(field: Json) -> str:
    if "anyOf" in field:
        return " or ".join(str(option.get("type", "table")) for option in cast("list[Json]", field["anyOf"]))
    return str(field.get("type", "table"))
