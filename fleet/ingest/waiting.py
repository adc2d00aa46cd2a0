"""Batches that wait for their transaction: tenants take turns, and so do the vehicles of each."""

import asyncio
from collections import Counter, OrderedDict, deque

from .verification import ReceivedBytes

MAX_BATCHES = 5000  # batches; what comes beyond is dropped, and vehicles send it again
VEHICLE_SHARE = 16  # of one vehicle among them: its outbox has four in flight


class TenantQueue:
    """A tenant has as many places as are free beside: whatever one sends, others find room."""

    def __init__(self, most: int = MAX_BATCHES) -> None:
        self._most, self._number = most, 0
        self._tenants: OrderedDict[int, OrderedDict[str, deque[ReceivedBytes]]] = OrderedDict()
        self._of_tenant = Counter[int]()
        self._arrived = asyncio.Event()

    def __len__(self) -> int:
        return self._number

    def add(self, tenant: int, one: ReceivedBytes) -> bool:
        """Keep a batch until its turn; False: there is no room for it."""
        if self._of_tenant[tenant] >= self._most - self._number:
            return False
        vehicles = self._tenants.setdefault(tenant, OrderedDict())
        rows = vehicles.setdefault(one.vehicle, deque())
        if len(rows) >= VEHICLE_SHARE:
            return False
        rows.append(one)
        self._of_tenant[tenant] += 1
        self._number += 1
        self._arrived.set()
        return True

    def take(self, most: int) -> list[ReceivedBytes]:
        """Give those whose turn it is; those of a vehicle in their order."""
        taken = list[ReceivedBytes]()
        while self._tenants and len(taken) < most:
            tenant, vehicles = self._tenants.popitem(last=False)
            vehicle, rows = vehicles.popitem(last=False)
            taken.append(rows.popleft())
            self._of_tenant[tenant] -= 1
            if rows:
                vehicles[vehicle] = rows
            if vehicles:
                self._tenants[tenant] = vehicles
            else:
                del self._of_tenant[tenant]
        self._number -= len(taken)
        if not self._number:
            self._arrived.clear()
        return taken

    async def any(self) -> None:
        """Wait until there is one."""
        await self._arrived.wait()
