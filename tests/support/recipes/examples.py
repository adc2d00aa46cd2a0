"""Tiny examples of all recipes: the edits of each step."""

from . import bus, devices, navigation, program
from .recipe import Example

EXAMPLES: dict[str, Example] = {**bus.EXAMPLES, **navigation.EXAMPLES, **devices.EXAMPLES, **program.EXAMPLES}
