"""Registrations that hold now: verified when they come, in memory, and in the file for the next process only."""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence

from pydantic import ValidationError

from shared.messages.toll import CONTRACTS, RegisteredStation, TollPassage, TollRegistration
from shared.toll.plaza import Plaza
from shared.toll.registration import fault_of, identity_of

from .chain import Chain
from .store import Store

MAX_IDENTITIES = 20_000
MAX_CONTRACTS = 4  # of one ticket or station ID; two already send its passages to review
TABLE = "registration"
Contract = tuple[str, str]  # token and tariff class


def identities_of(passage: TollPassage) -> list[str]:
    """What a contract must be bound to: the tickets of an authenticated passage, the station IDs of another one."""
    return [f"ticket {ticket}" for ticket in passage.tickets] or [f"station {n}" for n in passage.station_ids]


def contracts_of(registrations: Iterable[TollRegistration]) -> set[Contract]:
    """Contracts, each with its tariff class."""
    return {(registration.contract, registration.tariff_class) for registration in registrations}


class Registrations:
    """Contracts by ticket or station ID. Two contracts of one of them are both kept: the newest does not win."""

    def __init__(self, store: Store, plaza: Plaza, chain: Chain) -> None:
        self._store, self._plaza, self._chain = store, plaza, chain
        self._known: dict[str, dict[Contract, tuple[TollRegistration, int]]] = {}  # and until when
        self._stations: dict[int, set[str]] = {}  # identities of the registrations that name a station ID
        self.rejects: Counter[str] = Counter()
        for row in store.rows("SELECT content, valid_until_ns, seal FROM registration"):
            self._restore(row["content"], row["valid_until_ns"], row["seal"])

    def _restore(self, content: str, until_ns: int, seal: str | None) -> None:
        try:
            registration = TollRegistration.model_validate_json(content)
        except ValidationError:
            self.rejects["registration_changed"] += 1
            return
        if self._chain.is_row(seal, TABLE, identity_of(registration), content, until_ns):
            self._note(registration, until_ns)
        else:
            self.rejects["registration_changed"] += 1

    def accept(self, message: TollRegistration, until_ns: int) -> str | None:
        """Verify and keep a registration; return why it is refused."""
        if message.tariff_class not in self._plaza.tariff.classes:
            return "tariff class"
        fault = fault_of(
            message, plaza=self._plaza.name, operator_keys=self._plaza.operator_keys,
            require_ticket=self._plaza.require_authenticated,
        )  # fmt: skip
        if fault:
            return fault
        identity = identity_of(message)
        known = self._known.get(identity, {})
        contract = (message.contract, message.tariff_class)
        if (len(self._known) >= MAX_IDENTITIES and not known) or (
            len(known) >= MAX_CONTRACTS and contract not in known
        ):
            return "too many registrations"
        if contract in known and known[contract][0].sampled_ns >= message.sampled_ns:
            return None
        self._note(message, until_ns)
        content = message.model_dump_json(exclude_none=True)
        self._store.execute(
            "INSERT OR REPLACE INTO registration VALUES (?, ?, ?, ?, ?, ?)",
            identity, *contract, until_ns, content, self._chain.row_seal(TABLE, identity, content, until_ns),
        )  # fmt: skip
        return None

    def of(self, identities: Sequence[str], at_ns: int) -> list[TollRegistration]:
        """Registrations that held at a time."""
        return [
            registration
            for identity in identities
            for registration, until_ns in self._known.get(identity, {}).values()
            if until_ns >= at_ns
        ][:CONTRACTS]

    def is_of_another(self, passage: TollPassage, at_ns: int) -> bool:
        """Whether another ticket than those of a passage is registered with one of its station IDs."""
        own = set(identities_of(passage))
        others = {identity for station in passage.station_ids for identity in self._stations.get(station, ())} - own
        return bool(self.of(sorted(others), at_ns))

    def listed(self, now_ns: int, most: int) -> Iterator[RegisteredStation]:
        """What `core.toll` takes over after a restart, the newest first."""
        newest = sorted(
            (
                max(contracts.values(), key=lambda pair: pair[0].sampled_ns)
                for contracts in self._known.values()
                if any(until_ns >= now_ns for _, until_ns in contracts.values())
            ),
            key=lambda pair: pair[0].sampled_ns, reverse=True,
        )  # fmt: skip
        for registration, until_ns in newest[:most]:
            ticket = registration.ticket
            yield RegisteredStation(
                station_id=registration.station_id if ticket is None else None, ticket=ticket, valid_until_ns=until_ns
            )

    def expire(self, now_ns: int) -> None:
        """Forget what does not hold any more."""
        self._store.execute("DELETE FROM registration WHERE valid_until_ns < ?", now_ns)
        for identity, contracts in list(self._known.items()):
            valid = {contract: pair for contract, pair in contracts.items() if pair[1] >= now_ns}
            if valid:
                self._known[identity] = valid
            else:
                del self._known[identity]
        self._stations = {
            station: kept for station, names in self._stations.items() if (kept := names & self._known.keys())
        }

    def _note(self, registration: TollRegistration, until_ns: int) -> None:
        identity = identity_of(registration)
        contract = (registration.contract, registration.tariff_class)
        self._known.setdefault(identity, {})[contract] = registration, until_ns
        if registration.station_id is not None:
            self._stations.setdefault(registration.station_id, set()).add(identity)
