"""Codes of why nothing, or not everything, is recorded; `words.toml` beside this file has their words."""

from enum import StrEnum


class Code(StrEnum):
    """Why nothing is recorded, or what is left out."""

    CANNOT_WRITE = "recorder.cannot_write"
    CANNOT_USE_FOLDER = "recorder.cannot_use_folder"
    POWER_ENDS = "recorder.power_ends"
    CHARGE_ENDS = "recorder.charge_ends"
    AUTONOMY_ENDS = "recorder.autonomy_ends"
    BATTERY_TIME_ENDS = "recorder.battery_time_ends"
    OVER_QUOTA = "recorder.over_quota"  # nothing more may be deleted
    DISK_FULL = "recorder.disk_full"
    FLOOD = "recorder.flood"
