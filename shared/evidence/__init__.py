"""Evidence: what a unit has signed with its own key, and who can check it."""

from .outcome import Outcome
from .ring import KeyRing, PublicKey
from .signer import EvidenceError, KeyFile, Signer, keys_folder

__all__ = ["EvidenceError", "KeyFile", "KeyRing", "Outcome", "PublicKey", "Signer", "keys_folder"]
