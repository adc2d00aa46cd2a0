"""Filters of others, built by the reader from their own sources: each is run where it is, and passed over where not."""

from .common import Peer, PeerResult
from .kf_gins import KfGins
from .ob_gins import ObGins
from .px4 import Px4
from .pyins_peer import Pyins

PEERS: tuple[Peer, ...] = (KfGins(), ObGins(), Pyins(), Px4())

__all__ = ["PEERS", "Peer", "PeerResult"]
