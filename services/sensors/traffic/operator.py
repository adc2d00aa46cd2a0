"""The simulated operator: books every transaction once, also if repeated, and answers each with a receipt."""

from shared.messages.toll import TollReceipt, TollTransaction

MAX_BOOKED = 50_000  # the newest; a ledger sends at most 100 transactions without a receipt, each every minute


class Operator:
    """Inserts a transaction or ignores it by its ID, and always answers."""

    def __init__(self) -> None:
        self.booked: dict[str, TollTransaction] = {}

    def receive(self, transaction: TollTransaction, now_ns: int) -> TollReceipt:
        """Book what is new; answer to what is known as to the first time."""
        known = transaction.transaction_id in self.booked
        self.booked.setdefault(transaction.transaction_id, transaction)
        while len(self.booked) > MAX_BOOKED:
            del self.booked[next(iter(self.booked))]
        return TollReceipt(
            received_ns=now_ns, transaction_id=transaction.transaction_id, passage_id=transaction.passage_id,
            operator="simulated", accepted=True, duplicate=known,
        )  # fmt: skip
