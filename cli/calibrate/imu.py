"""`obu calibrate imu`: noise of the inertial sensors from a recording at rest."""

import json
from array import array
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from html import escape
from math import degrees, sqrt
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from shared.errors import UserError
from shared.maths.earth import STANDARD_GRAVITY
from shared.messages.imu import ImuSamples
from shared.runtime.offline import OfflineUnit

from ..output_file import insist_on_new, write_text
from ..progress import progress_on
from ..recordings.common import open_recording, print_problems, vehicle_of
from ..solve.inputs import inputs_of
from ..solve.report.drawing import COLOURS, inline_svg, label_decades, stacked_axes
from .allan import Allan, FloatArray, Noise, allan_deviation, cluster_counts, noise_of
from .rest import StandstillSamples, gaps, longest_rest

PROCESSES = ("parsers.gnss", "parsers.imu")
AXES = ("forward", "right", "down")
MIN_DURATION_S = 60.0  # the random walk is then known to a few percent
ADVISED_S = 3600.0  # the bias of most sensors shows within minutes to an hour
MAX_SAMPLES = 20_000_000  # 28 hours at 200 Hz, in 1.1 GB
HOUR_S = 3600.0
STYLE = (
    "body{font-family:sans-serif;max-width:50rem;margin:1rem auto;padding:0 1rem;color-scheme:light dark}"
    "svg{width:100%;height:auto}pre{padding:.6rem;border:1px solid #8a8f98;overflow:auto}"
    "td,th{text-align:right;padding:.1rem .6rem}"
)


@dataclass(frozen=True)
class Sensor:
    """One triad: its name, and deviation and noise of each axis."""

    name: str
    allans: Sequence[Allan]
    noises: Sequence[Noise]


def calibrate_imu(
    recording: Annotated[Path, typer.Argument(help="Recording of sensors at rest, of `obu record` or `obu import`.")],
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="FILE", help="Write a page with the plots as well, such as noise.html."),
    ] = None,
    vehicle: Annotated[
        Path | None, typer.Option("--vehicle", metavar="FILE", help="Vehicle TOML file; default: the recorded one.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as one JSON object.")] = False,
) -> int:
    """Measure the noise of the inertial sensors by the Allan deviation, and print the settings to paste.

    Let the unit record for an hour or more with the vehicle standing and its engine off.

    Examples:
    [bold]obu calibrate imu night.mcap[/]
    [bold]obu import mti.bin -o bench.mcap[/]
    [bold]obu calibrate imu bench.mcap --out noise.html --json[/]
    """
    if out is not None:
        insist_on_new(out)
    console = Console(stderr=True)
    with progress_on(console) as progress:
        source, rest = _at_rest(recording, vehicle, console, progress)
        sensors = [
            _sensor(name, values, rest.step_s)
            for name, values in (("gyroscope", rest.rates), ("accelerometer", rest.forces))
        ]
    text = section(*sensors, source=source, rest=rest, file=recording.name)
    if out is not None:
        write_text(out, _page(recording.name, source, rest, sensors, text))
    if as_json:
        print(json.dumps(_document(source, rest, sensors, text)))
        return 0
    Console().print(_table(sensors))
    page = f"Wrote {out}." if out is not None else "A page with the plots: --out noise.html."
    for line in (*said(rest, sensors), f"{page} Paste into the vehicle's file:", "", text):
        print(line)
    return 0


def _at_rest(path: Path, vehicle: Path | None, console: Console, progress: Progress) -> tuple[str, StandstillSamples]:
    with open_recording(path) as recording:
        inputs, file = inputs_of(recording), vehicle_of(recording, vehicle)
    print_problems(recording, console)
    rows: dict[str, array[float]] = {}
    first_ns: dict[str, int] = {}
    unit = OfflineUnit(file, PROCESSES)
    shown = progress.track(inputs.messages(file), total=len(inputs), description="reading samples")
    for message in unit.run(shown):
        if isinstance(message, ImuSamples):
            base_ns = first_ns.setdefault(message.source, message.sampled_ns[0])
            _append(rows.setdefault(message.source, array("d")), message, base_ns)
    if not rows:
        raise UserError(f"{path} holds no inertial samples; record the IMU as well")
    source = max(rows, key=lambda name: len(rows[name]))
    values = np.frombuffer(rows[source]).reshape(-1, 7)
    values = values[np.r_[True, np.diff(values[:, 0]) > 0.0]]
    rest = longest_rest(values[:, 0], values[:, 1:4], values[:, 4:7])
    duration_s = 0.0 if rest is None else rest.duration_s
    if rest is None or duration_s < MIN_DURATION_S:
        missing = gaps(values[:, 0])
        where = f" (samples are missing behind {values[missing[0], 0]:.1f} s by their stamps)" if len(missing) else ""
        raise UserError(
            f"the longest standstill in {path} is {duration_s:.0f} s{where}, and {MIN_DURATION_S:.0f} s are the least; "
            "record an hour with the vehicle standing, its engine off and nobody in it"
        )
    return source, rest


def _append(rows: "array[float]", message: ImuSamples, base_ns: int) -> None:
    """Append time since the first sample [s], force and rate: a double would not hold ns since 1970."""
    if len(rows) > 7 * MAX_SAMPLES:
        raise UserError(f"more than {MAX_SAMPLES:,} samples; record for a few hours only")
    for stamp, force, rate in zip(
        message.sampled_ns, message.specific_force_body_m_s2, message.angular_rate_body_rad_s, strict=True
    ):
        rows.extend(((stamp - base_ns) * 1e-9, *force, *rate))


def _sensor(name: str, values: FloatArray, step_s: float) -> Sensor:
    counts = cluster_counts(len(values))
    allans = [allan_deviation(values[:, axis], step_s, counts) for axis in range(3)]
    return Sensor(name, allans, [noise_of(allan) for allan in allans])


def section(gyroscope: Sensor, accelerometer: Sensor, *, source: str, rest: StandstillSamples, file: str) -> str:
    """Write the section of a vehicle's file, each value that of the worst axis; what is not seen is left out."""
    lines = [
        "[core.fusion.imu]",
        f"# {source}: Allan deviation of {rest.duration_s / HOUR_S:.2f} h at rest ({file}), worst axis",
    ]
    for key, bias_key, sensor in (
        ("angle_random_walk_rad_sqrt_s", "gyroscope_bias_psd_rad2_s3", gyroscope),
        ("velocity_random_walk_m_s_sqrt_s", "accelerometer_bias_psd_m2_s5", accelerometer),
    ):
        walk = max(noise.random_walk for noise in sensor.noises)
        if walk > 0.0:
            lines.append(f"{key} = {walk:.4g}")
        psds = [noise.bias_psd for noise in sensor.noises if noise.bias_psd is not None]
        if psds:
            lines.append(f"{bias_key} = {max(psds):.4g}")
    return "\n".join(lines)


def said(rest: StandstillSamples, sensors: Sequence[Sensor]) -> list[str]:
    """Sentences on what was measured, and what a longer recording would show."""
    lines = [f"{rest.duration_s:.0f} s at rest, from {rest.first_s:.0f} s on, at {1.0 / rest.step_s:.1f} Hz."]
    unseen = [sensor.name for sensor in sensors if any(noise.bias_psd is None for noise in sensor.noises)]
    if unseen:
        lines.append(
            f"On some axes of {' and '.join(unseen)} the bias does not stand out of the noise: bias instability is an "
            "upper limit, and the present setting stays where no axis shows one."
        )
    if rest.duration_s < ADVISED_S:
        lines.append("An hour or more at rest shows the bias instability better.")
    return lines


def _table(sensors: Sequence[Sensor]) -> Table:
    table = Table(box=None, pad_edge=False)
    for title in ("sensor", "axis", "random walk", "bias instability", "at", "bias, 1 sigma", "correlation time"):
        table.add_column(title, justify="left" if title in ("sensor", "axis") else "right")
    for row in _rows(sensors):
        table.add_row(*row)
    return table


def _rows(sensors: Sequence[Sensor]) -> list[tuple[str, ...]]:
    return [
        (sensor.name, axis, *_shown(sensor.name, noise))
        for sensor in sensors
        for axis, noise in zip(AXES, sensor.noises, strict=True)
    ]


def _shown(name: str, noise: Noise) -> tuple[str, ...]:
    """Values in the units of data sheets."""
    if name == "gyroscope":
        walk, bias, unit = f"{degrees(noise.random_walk) * sqrt(HOUR_S):.4g} deg/sqrt(h)", degrees(HOUR_S), "deg/h"
    else:
        walk, bias, unit = f"{noise.random_walk * sqrt(HOUR_S):.4g} m/s/sqrt(h)", 1e6 / STANDARD_GRAVITY, "ug"
    limit = "" if noise.minimum_seen else "< "
    return (
        walk,
        f"{limit}{noise.instability * bias:.3g} {unit}",
        f"{noise.instability_time_s:.3g} s",
        "-" if noise.bias_sd is None else f"{noise.bias_sd * bias:.3g} {unit}",
        "-" if noise.correlation_s is None else f"{noise.correlation_s:.3g} s",
    )


def _document(source: str, rest: StandstillSamples, sensors: Sequence[Sensor], text: str) -> dict[str, object]:
    return {
        "source": source,
        "duration_s": round(rest.duration_s, 3),
        "rate_hz": round(1.0 / rest.step_s, 4),
        **{
            sensor.name: {
                axis: asdict(noise) | {"times_s": allan.times_s.tolist(), "deviation": allan.deviation.tolist()}
                for axis, noise, allan in zip(AXES, sensor.noises, sensor.allans, strict=True)
            }
            for sensor in sensors
        },
        "section": text,
    }


def _page(name: str, source: str, rest: StandstillSamples, sensors: Sequence[Sensor], text: str) -> str:
    figures = "\n".join(f"<h2>{sensor.name.capitalize()}</h2>{_drawn(sensor)}" for sensor in sensors)
    heads = ("sensor", "axis", "random walk", "bias instability", "at", "bias, 1 σ", "correlation time")
    rows = "\n".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in _rows(sensors))
    sentences = "".join(f"<p>{escape(sentence)}</p>" for sentence in said(rest, sensors))
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(name)}: noise of {escape(source)}</title><style>{STYLE}</style></head>
<body><h1>Noise of {escape(source)}</h1><p>Overlapping Allan deviation of {escape(name)}.</p>{sentences}
{figures}
<table><tr>{"".join(f"<th>{head}</th>" for head in heads)}</tr>
{rows}</table>
<h2>Settings</h2><pre>{escape(text)}</pre></body></html>
"""


def _drawn(sensor: Sensor) -> str:
    found: list[str] = []
    unit = "deg/h" if sensor.name == "gyroscope" else "µg"
    scale = degrees(HOUR_S) if sensor.name == "gyroscope" else 1e6 / STANDARD_GRAVITY
    with stacked_axes(1, 3.6, found.append) as (axes,):
        for axis, colour, allan, noise in zip(AXES, COLOURS, sensor.allans, sensor.noises, strict=True):
            axes.loglog(allan.times_s, allan.deviation * scale, color=colour, label=axis)
            white = noise.random_walk / np.sqrt(allan.times_s) * scale
            axes.loglog(allan.times_s, white, color=colour, linewidth=0.6, linestyle=":")
        axes.set_xlabel("cluster time [s]")
        axes.set_ylabel(f"Allan deviation [{unit}]")
        label_decades(axes.xaxis, axes.yaxis)
        axes.legend(title="dotted: white noise alone")
    return inline_svg(found[0], f"Allan deviation of the {sensor.name}")
