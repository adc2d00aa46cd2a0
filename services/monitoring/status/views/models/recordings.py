"""The recordings of this unit."""

from typing_extensions import TypedDict

from shared.page.answers import Object, Stamp, answer


@answer()
class SummaryShown(TypedDict):
    """A recording at a glance."""

    begin_ns: Stamp
    end_ns: Stamp
    origin: str | None
    distance_m: float | None
    outline: str | None
    """track as an SVG path"""
    trust: list[Object]
    outages: list[Object]


@answer()
class RecordingShown(TypedDict):
    """One recording."""

    name: str
    size_bytes: int
    kept: bool
    recording: bool
    """it is being written"""
    failed: bool
    """no summary can be computed of it"""
    summary: SummaryShown | None
    report: bool
    """there is one of its last solution"""


@answer()
class JobShown(TypedDict):
    """The replay or solution that runs, or ran last."""

    action: str | None
    name: str
    running: bool
    failed: bool
    port: int | None
    """of a replay's page"""
    text: str
    """last line of its output"""


@answer()
class Recordings(TypedDict):
    """The recordings, newest first, what may be done with them, and the job that runs."""

    recordings: list[RecordingShown]
    free_bytes: int | None
    allowed: list[str]
    job: JobShown | None
