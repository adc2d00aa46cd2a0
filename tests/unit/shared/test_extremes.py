"""No number of a message is unbounded, and every process works with what the bounds let through."""

import importlib
import math
import pkgutil
import random
import re
import types
import typing
from collections import Counter
from collections.abc import Iterator
from enum import Enum
from typing import Annotated, Any, cast

import annotated_types
import pytest
from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from shared import messages
from shared.faults import FAULT, Faults
from shared.messages.base import Message, RawBytes
from shared.processes import PROCESSES
from shared.runtime import offline
from shared.runtime.config import load_vehicle, parse_vehicle
from shared.runtime.live import Reactor, arrival_ns, handled, load_process
from shared.topics import subscriptions
from tests.support.cases import each
from tests.support.drives.golden import VEHICLE, device_bytes

HUGE: tuple[object, ...] = (math.inf, -math.inf, math.nan, 1e300, -1e300, 10**400, -(10**400), 2**200)
Place = tuple[str | int, ...]


def all_messages() -> list[type[Message]]:
    modules = [
        importlib.import_module(f"{messages.__name__}.{m.name}") for m in pkgutil.iter_modules(messages.__path__)
    ]
    kinds = {k for m in modules for k in vars(m).values() if isinstance(k, type) and issubclass(k, Message)}
    return sorted(kinds, key=lambda kind: kind.__name__)


def constraints(metadata: typing.Iterable[object]) -> Iterator[object]:
    for value in metadata:
        yield from constraints(value.metadata) if isinstance(value, FieldInfo) else (value,)


class Maker:
    """Makes values of an annotation; each number is at its upper or its lower bound."""

    def __init__(self, *, high: bool) -> None:
        self._high = high
        self.numbers = 0

    def value(self, annotation: Any, metadata: tuple[object, ...] = ()) -> Any:
        origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
        if origin is Annotated:
            return self.value(arguments[0], (*metadata, *constraints(arguments[1:])))
        if origin in (typing.Union, types.UnionType):
            return self.value(next(a for a in arguments if a is not type(None)), metadata)
        if origin is tuple:
            least = [value.min_length for value in metadata if isinstance(value, annotated_types.MinLen)]
            repeated = arguments[:1] * max(1, *least, 0)
            return tuple(self.value(item) for item in (repeated if arguments[-1] is Ellipsis else arguments))
        if origin is dict:
            return {"x": self.value(arguments[1])}
        return self._scalar(annotation, metadata)

    def _scalar(self, kind: Any, metadata: tuple[object, ...]) -> Any:
        if kind in (int, float):
            self.numbers += 1
            return self._number(kind, metadata)
        if kind is str:
            patterns = [value.pattern for value in metadata if getattr(value, "pattern", None)]  # type: ignore[attr-defined]
            return next(
                text
                for text in ("x", *("0" * n for n in (16, 32, 64, 128)), "EUR", "owner.code")
                if all(re.match(p, text) for p in patterns)
            )
        if issubclass(kind, BaseModel):
            return kind(**self.fields(kind))
        if issubclass(kind, Enum):
            return list(kind)[-1 if self._high else 0]
        return {bytes: b"x", bool: self._high}[kind]

    def _number(self, kind: type[int] | type[float], metadata: tuple[object, ...]) -> int | float:
        low: list[Any] = [value for value in metadata if isinstance(value, annotated_types.Ge | annotated_types.Gt)]
        high: list[Any] = [value for value in metadata if isinstance(value, annotated_types.Le | annotated_types.Lt)]
        assert low and high, "a number without bounds"
        if self._high:
            value: Any = min(
                [cast(Any, le.le if isinstance(le, annotated_types.Le) else self._below(le.lt)) for le in high]
            )
        else:
            value = max([cast(Any, ge.ge if isinstance(ge, annotated_types.Ge) else self._above(ge.gt)) for ge in low])
        return kind(value)

    @staticmethod
    def _below(limit: Any) -> Any:
        return limit - 1 if isinstance(limit, int) else math.nextafter(limit, -math.inf)

    @staticmethod
    def _above(limit: Any) -> Any:
        return limit + 1 if isinstance(limit, int) else math.nextafter(limit, math.inf)

    def fields(self, kind: type[BaseModel]) -> dict[str, Any]:
        made = {}
        for name, info in kind.model_fields.items():
            try:
                made[name] = self.value(info.annotation, tuple(constraints(info.metadata)))
            except AssertionError as error:
                raise AssertionError(f"{kind.__name__}.{name}: {error}") from error
        return made


def extreme(kind: type[Message], *, high: bool) -> Message:
    made = Maker(high=high).fields(kind)
    if kind.__name__ == "LearnedGrade":
        made["metrics"] = ("x",)
    return kind(**made)


@each("high", [True, False])
@each("kind", all_messages())
def test_every_number_has_bounds_and_is_accepted_at_them(kind: type[Message], high: bool) -> None:
    made = extreme(kind, high=high)
    assert kind.model_validate_json(made.model_dump_json()) == made


def places(value: Any, place: Place = ()) -> Iterator[Place]:
    if isinstance(value, bool | str | bytes | None):
        return
    if isinstance(value, dict):
        for name, part in value.items():
            yield from places(part, (*place, name))
    elif isinstance(value, list | tuple):
        for k, part in enumerate(value):
            yield from places(part, (*place, k))
    elif isinstance(value, int | float) and not isinstance(value, Enum):
        yield place


def replaced(value: Any, place: Place, new: object) -> Any:
    if not place:
        return new
    head, *rest = place
    changed = replaced(value[head], tuple(rest), new)
    if isinstance(value, dict):
        return {**value, head: changed}
    return tuple(changed if k == head else part for k, part in enumerate(value))


@each("kind", all_messages())
def test_infinite_and_huge_numbers_are_refused_wherever_they_stand(kind: type[Message]) -> None:
    whole = extreme(kind, high=False).model_dump()
    for place in places(whole):
        for huge in HUGE:
            with pytest.raises(ValidationError):
                kind.model_validate(replaced(whole, place, huge), strict=True)


REACTORS = [row.name for row in PROCESSES if row.is_function]
ROAD_SIDE = {row.name for row in PROCESSES if "obu" not in {role.value for role in row.roles}}


@each("name", REACTORS)
def test_every_process_works_with_what_the_bounds_let_through(name: str) -> None:
    role = "rsu" if name in ROAD_SIDE else "obu"
    process = typing.cast(Reactor, load_process(name, parse_vehicle(f'[vehicle]\nrole = "{role}"\n')))
    rejects: Counter[str] = Counter()
    faults = Faults(rejects)
    for high in (False, True, False):
        for topic in subscriptions(name):
            message = extreme(topic.message, high=high)
            list(handled(process, message, faults, 0))
    assert not rejects[FAULT], faults.last


class MutatedInput:
    """Gives a process beside each message, now and then, one in which one number is at its bound."""

    def __init__(self, seed: int, share: float) -> None:
        self.given: Counter[str] = Counter()
        self._random, self._share = random.Random(seed), share
        self._extremes: dict[tuple[type[Message], bool], Message] = {}

    def handled(self, process: Reactor, message: Message, faults: Faults, now_ns: int) -> Iterator[Message]:
        if not isinstance(message, RawBytes) and self._random.random() < self._share:
            changed = self._changed(message, high=self._random.random() < 0.5)
            if changed is not None:
                self.given[type(message).__name__] += 1
                yield from process.handle(changed)
        yield from process.handle(message)

    def _changed(self, message: Message, *, high: bool) -> Message | None:
        whole, kind = message.model_dump(), type(message)
        place = self._random.choice(list(places(whole)))
        bound: Any = self._extremes.setdefault((kind, high), extreme(kind, high=high)).model_dump()
        for step in place:
            if isinstance(step, int):
                bound = bound[min(step, len(bound) - 1)]
            else:
                bound = bound.get(step, next(iter(bound.values())))  # all values of a table have the same bounds
        if not isinstance(bound, int | float):
            return None
        try:
            return kind.model_validate(replaced(whole, place, bound), strict=True)
        except ValidationError:
            return None  # the numbers of this message depend on each other


def test_no_process_ends_by_a_number_at_its_bound_within_a_drive(monkeypatch: pytest.MonkeyPatch) -> None:
    mutating = MutatedInput(seed=1, share=0.3)
    monkeypatch.setattr(offline, "handled", mutating.handled)
    unit = offline.OfflineUnit(load_vehicle(VEHICLE))
    start_ns: int | None = None
    for message in unit.run(device_bytes()):
        stamp_ns = arrival_ns(message) if isinstance(message, RawBytes) else None
        start_ns = start_ns or stamp_ns
        if stamp_ns is not None and start_ns is not None and stamp_ns > start_ns + 25 * 10**9:
            break
    assert mutating.given.total() > 500
    assert {"GnssFix", "ImuSamples", "VehicleSpeed", "WheelSpeeds", "NavigationSolution"} <= mutating.given.keys()
