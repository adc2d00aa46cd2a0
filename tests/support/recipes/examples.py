"""Tiny examples of all recipes: the edits of each step."""

from . import bus
from .recipe import Example

EXAMPLES: dict[str, Example] = {**bus.EXAMPLES}
