"""Examples of what travels on the bus or steers a process: a setting, a message."""

from .recipe import Example
from .tree import Edit

POWER = "services/parsers/power/process.py"
TEST = "tests/unit/parsers/power/test_recipe.py"

SETTING: Example = (
    (
        Edit(POWER, """    silent_after_s: float = Field(
        default=5.0, gt=1.0, le=60.0, description="age from which a reading of the supply no longer counts"
    )
""", after="""class Config(Section):
    \"""Settings of the parser of power; those of voltages are for a UPS with two lithium cells.\"""

"""),
    ),
    (
        Edit(POWER, "> self._config.silent_after_s * NS", instead_of="> SILENCE_TIMEOUT_NS"),
        Edit(POWER, "", instead_of="SILENCE_TIMEOUT_NS = 5 * NS  # readings come every second\n"),
    ),
)  # fmt: skip

MESSAGE: Example = (
    (
        Edit("shared/messages/power.py", """

class PowerForecast(Message):
    \"""How long the battery will last at the present current.\"""

    sampled_ns: Nanoseconds
    source: Name
    left_s: Seconds
""", after="""    on_battery: bool
    low: bool
    reason: Reason
"""),
    ),
    (
        Edit("shared/topics.py", "PowerEvent, PowerForecast, PowerRaw", instead_of="PowerEvent, PowerRaw"),
        Edit("shared/topics.py", """
    Topic("power/forecast", PowerForecast, "how long the battery will last", qos=1),""",
             after="""    Topic("power/raw", PowerRaw, "readings of the power supply"),"""),
    ),
    (
        Edit("shared/processes.py", """produces=("power/state", "power/event", "power/forecast"),""",
             instead_of="""produces=("power/state", "power/event"),"""),
    ),
    (
        Edit(POWER, "PowerEvent, PowerForecast, PowerRaw", instead_of="PowerEvent, PowerRaw"),
        Edit(POWER, "PowerState | PowerEvent | PowerForecast", instead_of="PowerState | PowerEvent"),
        Edit(POWER, """
                yield PowerForecast(sampled_ns=message.now_ns, source=self._source, left_s=self._low.below_s() or 0.0)
""", after="""                yield self._state(message.now_ns)"""),
    ),
)  # fmt: skip

EXAMPLES = {"setting": SETTING, "message": MESSAGE}
