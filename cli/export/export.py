"""`obu export`: a recording in the formats of other tools."""

import json
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from datetime import UTC, datetime
from enum import StrEnum
from functools import partial
from math import radians
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from shared.errors import UserError
from shared.maths.earth import Geodetic, ecef_from_geodetic
from shared.messages.gnss import GnssRawEpoch
from shared.track_files import gpx_lines, iso_time, kml_lines

from ..output_file import insist_on_place
from ..recordings.common import open_recording, print_problems, vehicle_of
from ..utc import UtcLine
from .nmea import nmea_lines
from .positions import Position, of_fixes, of_solutions, segments, spaced
from .rinex import Content, epoch_lines, header_lines
from .source import Source
from .table import csv_lines

SOLUTIONS, FIXES, RAW = "navigation/solution", "gnss/fix", "gnss/raw_epoch"


class Format(StrEnum):
    """File formats."""

    CSV = "csv"
    GPX = "gpx"
    KML = "kml"
    GEOJSON = "geojson"
    NMEA = "nmea"
    RINEX = "rinex"


SUFFIXES = {Format.NMEA: "nmea", Format.RINEX: "obs"}


def export(  # one argument an option
    file: Annotated[Path, typer.Argument(help="A recording, from `obu record`, the unit's recorder or `obu import`.")],
    *,
    to: Annotated[Format, typer.Option("--format", help="File format.")],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", metavar="FILE", help="File to write; default: name of the recording, other suffix."
        ),
    ] = None,
    topic: Annotated[
        str | None,
        typer.Option(
            metavar="TOPIC",
            help="csv: the topic of the rows. Others: navigation/solution or gnss/fix. Default: solutions.",
        ),
    ] = None,
    period: Annotated[
        float, typer.Option(min=0.0, metavar="SECONDS", help="Least time between two positions; 0: all of them.")
    ] = 0.0,
) -> int:
    """Write a recording for other tools: tables, tracks, NMEA 0183, or raw measurements as RINEX 3.05.

    Times are UTC as the receiver stated it; without it, the time of the recording. Of csv this is the first column, and
    the fields behind it are as recorded, with stamps of the unit's time line. RINEX is in GPS time.

    Examples:
    [bold]obu export drive.mcap --format gpx[/]
    [bold]obu export drive.mcap --format nmea --period 1 --out drive.nmea[/]
    [bold]obu export drive.mcap --format csv --topic gnss/satellites[/]
    [bold]obu export drive.mcap --format rinex[/]
    """
    console = Console(stderr=True)
    path = out or Path(f"{file.stem}.{SUFFIXES.get(to, to.value)}")
    insist_on_place(path)
    with open_recording(file) as recording:
        topics = recording.topics or frozenset(envelope.topic for envelope in recording)
        source = Source(recording, vehicle_of(recording, None), topics, console)
        lines = _lines(source, to, topic, period)
        count = _write(path, lines, 2 if to is Format.CSV else 1, lambda: _nothing(source, to, topic))
        print_problems(recording, console)
    print(f"wrote {path}: {count} lines")
    return 0


def _nothing(source: Source, to: Format, topic: str | None) -> UserError:
    """Why there is nothing to export."""
    what = topic or ("solution or fix" if to is Format.CSV else "position")
    return UserError(
        f"{source.recording.path.name} holds no {what} that can be read, and nothing was written{_problems(source)}"
    )


def _problems(source: Source) -> str:
    """What cannot be read of a recording, as the end of a sentence."""
    deque(source.recording, maxlen=0)
    return "".join(f"; {problem}" for problem in source.recording.problems)


def _lines(source: Source, to: Format, topic: str | None, period_s: float) -> Iterable[str]:
    name = source.recording.path.stem
    if to is Format.RINEX:
        return _rinex(source, name)
    topic = topic or next((name for name in (SOLUTIONS, FIXES) if source.has(name)), None)
    if topic is None or not source.has(topic):
        held = ", ".join(sorted(source.topics)[:12]) or f"nothing that can be read{_problems(source)}"
        raise UserError(
            f"{name} holds no {topic or 'solutions or fixes'}; it holds {held}: `obu solve` computes a solution, "
            "--topic names another topic"
        )
    if to is Format.CSV:
        return csv_lines(partial(source.messages, topic), source.utc().utc_ns)
    if topic not in (SOLUTIONS, FIXES):
        raise UserError(f"{to} is made of positions: give --topic {SOLUTIONS} or {FIXES}, or take --format csv")
    positions = spaced(_positions(source, topic), period_s)
    if to is Format.NMEA:
        return nmea_lines(positions)
    track = segments(positions)
    if not track:
        raise UserError(
            f"{name} holds no position; `obu export {name}.mcap --format csv --topic {topic}` shows why"
            f"{_problems(source)}"
        )
    if to is Format.GEOJSON:
        return geojson_lines(name, track)
    points = [[position.track_point() for position in segment] for segment in track]
    return gpx_lines(name, points) if to is Format.GPX else kml_lines(name, points)


def _positions(source: Source, topic: str) -> Iterator[Position]:
    utc = source.utc()
    if topic == FIXES:
        return of_fixes(source.messages(FIXES), utc)
    fixes = source.messages(FIXES) if source.has(FIXES) else iter(())
    return of_solutions(source.messages(SOLUTIONS), fixes, utc)


def geojson_lines(name: str, track: list[list[Position]]) -> Iterator[str]:
    """Format a track as one GeoJSON feature a segment (RFC 7946), with the times of its points beside it."""
    yield '{"type": "FeatureCollection", "features": [\n'
    for place, segment in enumerate(track):
        alone = len(segment) == 1  # a line has two points at least
        points = [_geojson_point(position) for position in segment]
        feature = {
            "type": "Feature",
            "properties": {
                "name": name,
                "times": [iso_time(position.time_ns) for position in segment],
                "speeds_m_s": [_rounded(position.speed_m_s) for position in segment],
                "position_sds_m": [_rounded(position.position_sd_m) for position in segment],
                "protection_levels_horizontal_m": [_rounded(p.protection_level_horizontal_m) for p in segment],
            },
            "geometry": {"type": "Point" if alone else "LineString", "coordinates": points[0] if alone else points},
        }
        yield json.dumps(feature) + (",\n" if place < len(track) - 1 else "\n")
    yield "]}\n"


def _geojson_point(position: Position) -> list[float]:
    point = [round(position.longitude_deg, 9), round(position.latitude_deg, 9)]
    return point if position.height_ellipsoid_m is None else [*point, round(position.height_ellipsoid_m, 3)]


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 3)


def _rinex(source: Source, name: str) -> Iterator[str]:
    if not source.has(RAW):
        raise UserError(
            f"{name} holds no raw measurements; a receiver that sends RXM-RAWX has them: --format nmea"
            f"{_problems(source)}"
        )
    content = Content()
    for message in source.messages(RAW):
        if isinstance(message, GnssRawEpoch):
            content.add(message)
    if content.first_ns is None or not content.codes:
        raise UserError(f"the receiver of {name} sent no raw measurements; --format nmea has its positions")
    yield from header_lines(content, name, _first_ecef(source), datetime.now(UTC))
    epochs = (message for message in source.messages(RAW) if isinstance(message, GnssRawEpoch))
    yield from epoch_lines(epochs, content)


def _first_ecef(source: Source) -> tuple[float, float, float]:
    """Give the first fix in ECEF; zeros, as RINEX has it, if there is none."""
    for position in of_fixes(source.messages(FIXES), UtcLine(())) if source.has(FIXES) else ():
        height = position.height_ellipsoid_m or 0.0
        x, y, z = ecef_from_geodetic(Geodetic(radians(position.latitude_deg), radians(position.longitude_deg), height))
        return float(x), float(y), float(z)
    return 0.0, 0.0, 0.0


def _write(path: Path, lines: Iterable[str], fewest: int, nothing: Callable[[], UserError]) -> int:
    """Write the lines beside the file, and put it in place when it is whole; with fewer lines, raise `nothing`."""
    draft = path.with_name(f"{path.name}.part")
    count = 0
    try:
        with draft.open("w", encoding="utf-8", newline="") as file:
            for line in lines:
                file.write(line)
                count += 1
        if count < fewest:
            raise nothing()
        draft.replace(path)
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror}; make room or name another file with --out") from error
    finally:
        draft.unlink(missing_ok=True)
    return count
