"""How much a vehicle, and a tenant with all its vehicles, may have stored: what is beyond gets no receipt.

Each has two accounts, in bytes of storage. One is filled within minutes, so that neither disk nor other vehicles notice
a flood; its rate is some hundred times that of a day, by which the outbox of a week without network is emptied within
an hour. The other is filled at the rate of the day. Of the accounts of a tenant a part is kept for vehicles that report
as usual, so that those that flood do not stop them.

Nothing is lost: what gets no receipt stays in the outbox, and the vehicle sends it again. Accounts are of a process:
where several ingests share the work, each lets as much through.
"""

import json
from collections import OrderedDict
from dataclasses import dataclass
from typing import NamedTuple

from .keys import Limits
from .verification import VerifiedBatch

MB = 1_000_000
DAY_S = 86_400.0
ROW_BYTES = 256  # of a batch with its index
EVENT_BYTES = 128  # of an event
REPORT_BYTES = 16  # of a report when it is read
MAX_VEHICLES = 200_000
RESERVE = 0.25  # of a tenant's accounts, for vehicles that have used less than `DEFAULT_BUDGET` of their own day
DEFAULT_BUDGET = 0.1
VEHICLE, TENANT = "vehicle", "tenant"


class Shape(NamedTuple):
    """Sizes of both accounts, as parts of the budget of a day."""

    burst: float  # at once
    rush: float  # a second
    held: float = 3.0  # days that are held at most


SHAPES = {VEHICLE: Shape(0.1, 1e-3), TENANT: Shape(0.002, 1e-4)}


@dataclass
class _Account:
    """Bytes that are left now, and within days; below zero by one batch at most."""

    shape: Shape
    day_bytes: float
    at_s: float
    now: float
    days: float

    @classmethod
    def full(cls, shape: Shape, day_mb: int, at_s: float) -> "_Account":
        size = float(day_mb * MB)
        return cls(shape, size, at_s, shape.burst * size, shape.held * size)

    def fill(self, day_mb: int, at_s: float) -> None:
        """Let time pass; the budget may be another one than before."""
        size, passed_s = float(day_mb * MB), max(0.0, at_s - self.at_s)
        if size != self.day_bytes:
            changed = size / self.day_bytes
            self.now, self.days, self.day_bytes = self.now * changed, self.days * changed, size
        self.now = min(self.shape.burst * size, self.now + passed_s * self.shape.rush * size)
        self.days = min(self.shape.held * size, self.days + passed_s * size / DAY_S)
        self.at_s = at_s

    @property
    def left(self) -> float:
        """The smaller part that is left of both, 1 if they are full."""
        held = self.shape.held * self.day_bytes
        return min(self.now / (self.shape.burst * self.day_bytes), self.days / held)

    @property
    def is_usual(self) -> bool:
        """Whether it was used by less than a part of a day lately."""
        return self.days >= (self.shape.held - DEFAULT_BUDGET) * self.day_bytes

    def take(self, size: int) -> None:
        self.now -= size
        self.days -= size


class Budgets:
    """The accounts of all vehicles and tenants; times in s of any clock."""

    def __init__(self) -> None:
        self._vehicles: OrderedDict[str, _Account] = OrderedDict()
        self._tenants: dict[int, _Account] = {}

    def is_empty(self, vehicle: str, at_s: float) -> bool:
        """Whether nothing of a vehicle can be stored now, without a look at what it has sent."""
        account = self._vehicles.get(vehicle)
        if account is None:
            return False
        account.fill(round(account.day_bytes / MB), at_s)
        return account.left <= 0.0

    def withheld(self, vehicle: str, tenant: int | None, limits: Limits, size: int, at_s: float) -> str | None:
        """Take bytes from the accounts; or say whose account is empty, and take nothing.

        `tenant` is None for what no known key has signed, which counts for the vehicle alone.
        """
        own = self._of_vehicle(vehicle, limits.vehicle_mb, at_s)
        if own.left <= 0.0:
            return VEHICLE
        if tenant is not None:
            shared = self._tenants.get(tenant)
            if shared is None:
                shared = self._tenants[tenant] = _Account.full(SHAPES[TENANT], limits.tenant_mb, at_s)
            shared.fill(limits.tenant_mb, at_s)
            if shared.left <= (0.0 if own.is_usual else RESERVE):
                return TENANT
            shared.take(size)
        own.take(size)
        return None

    def _of_vehicle(self, vehicle: str, day_mb: int, at_s: float) -> _Account:
        account = self._vehicles.pop(vehicle, None) or _Account.full(SHAPES[VEHICLE], day_mb, at_s)
        account.fill(day_mb, at_s)
        self._vehicles[vehicle] = account
        if len(self._vehicles) > MAX_VEHICLES:
            self._vehicles.popitem(last=False)
        return account


def storage_bytes(one: VerifiedBatch) -> int:
    """About what the database needs for a batch, however well it is compressed."""
    batch = one.batch
    events = sum(EVENT_BYTES + len(json.dumps(event.content)) for event in batch.events)
    return ROW_BYTES + max(len(one.data), REPORT_BYTES * len(batch.reports)) + events
