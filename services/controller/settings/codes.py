"""Codes of what has become of a change of settings; `words.toml` beside this file has their words."""

from enum import StrEnum


class Code(StrEnum):
    """Why a change is refused or taken back, and what was noticed; `shared/settings/check.py` has further ones."""

    NO_FILE = "settings.no_file"
    BUSY = "settings.busy"  # another change is watched
    NO_CHANGE = "settings.no_change"  # to be confirmed or taken back
    NO_VERSION = "settings.no_version"
    CANNOT_WRITE = "settings.cannot_write"
    CHECK_FAILED = "settings.check_failed"
    INTERRUPTED = "settings.interrupted"  # by the end of the process, before it was written
    EDITED = "settings.edited"  # the vehicle's file, by hand
    MEANWHILE = "settings.meanwhile"  # another text was written
    NOT_STARTED = "settings.not_started"
    NOT_COMPARED = "settings.not_compared"
    ASKED = "settings.asked"  # to take it back
    UNCONFIRMED = "settings.unconfirmed"
    PROCESS_DOWN = "settings.process_down"
    KEEPS_ENDING = "settings.keeps_ending"
    TOPIC_SILENT = "settings.topic_silent"
    MORE_REJECTS = "settings.more_rejects"
