"""Codes of what `obu import` has estimated and corrected; `words.toml` beside this file has their words."""

from enum import StrEnum


class Code(StrEnum):
    """What was estimated of a file, and applied to it."""

    AXES_ESTIMATED = "import.axes_estimated"
    DELAY_ESTIMATED = "import.delay_estimated"
    CLOCK_SHIFTED = "import.clock_shifted"
