"""What a receiver says of its signals and clock: NAV-STATUS, NAV-CLOCK, MON-RF and SEC-SIG of UBX.

They are unpacked here as NAV-SAT is. A version that the interface description does not define is rejected.

Source: u-blox F9 HPG 1.32 interface description (UBX-22008968), UBX-MON, UBX-NAV and UBX-SEC;
version 2 of SEC-SIG as pyubx2 has it.
"""

import struct
from collections.abc import Callable

from shared.messages.gnss import (
    MAX_RADIO_PATHS,
    InterferenceState,
    RadioPath,
    ReceiverClock,
    ReceiverStatus,
    SignalFlags,
)

from .messages import UbxError

# Message, and the field of `GnssSignalQuality` that it fills.
FIELDS = {"NAV-STATUS": "status", "NAV-CLOCK": "clock", "MON-RF": "radio_paths", "SEC-SIG": "security"}
AGC_FULL = 8191  # [-] largest count of the gain control
INDICATOR_FULL = 255
_STATUS = struct.Struct("<4x3xBI4x")
_CLOCK = struct.Struct("<4xiiII")
_PATH = struct.Struct("<BB10xHHB3x")
_PATH_SIZES = (20, 24)  # [bytes] of ZED-F9R, and of the interface description; what is read is the same
_UNKNOWN, _NONE, _INDICATED, _SEVERE = InterferenceState
_JAMMING = (_UNKNOWN, _NONE, _INDICATED, _SEVERE)
_SPOOFING = (_UNKNOWN, _NONE, _INDICATED, _SEVERE, _UNKNOWN, _UNKNOWN, _UNKNOWN, _UNKNOWN)
Part = SignalFlags | ReceiverClock | tuple[RadioPath, ...]


def decode(kind: str, payload: bytes) -> Part:
    """Decode a message of `FIELDS`; raises UbxError for a truncated one or an unknown version."""
    return _DECODERS[kind](payload)


def _status(payload: bytes) -> ReceiverStatus:
    flags2, first_fix_ms = _exactly(_STATUS, payload)
    return ReceiverStatus(
        spoofing=_SPOOFING[flags2 >> 3 & 3],
        time_to_first_fix_s=first_fix_ms * 1e-3 if first_fix_ms else None,
    )


def _clock(payload: bytes) -> ReceiverClock:
    bias_ns, drift_ns_s, time_ns, frequency_ps_s = _exactly(_CLOCK, payload)
    return ReceiverClock(
        bias_s=bias_ns * 1e-9, drift_ratio=drift_ns_s * 1e-9, bias_sd_s=time_ns * 1e-9,
        drift_sd_ratio=frequency_ps_s * 1e-12,
    )  # fmt: skip


def _radio_paths(payload: bytes) -> tuple[RadioPath, ...]:
    _version(payload, 0)
    count = payload[1] if len(payload) >= 4 else 0
    size = (len(payload) - 4) // count if count else 0
    if count > MAX_RADIO_PATHS or len(payload) != 4 + count * size or (count and size not in _PATH_SIZES):
        raise UbxError("short")
    blocks = (_PATH.unpack_from(payload, 4 + k * size) for k in range(count))
    return tuple(
        RadioPath(
            number=number, jamming=_JAMMING[flags & 3], noise_level=noise, gain_ratio=min(gain / AGC_FULL, 1.0),
            narrowband_ratio=indicator / INDICATOR_FULL,
        )
        for number, flags, noise, gain, indicator in blocks
    )  # fmt: skip


def _security(payload: bytes) -> SignalFlags:
    """Version 1 has a byte each for jamming and spoofing, version 2 one for both; bit 0 of each says "enabled"."""
    version = _version(payload, 1, 2)
    if len(payload) < (12 if version == 1 else 4):
        raise UbxError("short")
    jamming, spoofing = (payload[4], payload[8]) if version == 1 else (payload[1] & 7, payload[1] >> 3)
    return SignalFlags(
        jamming=_JAMMING[jamming >> 1 & 3] if jamming & 1 else _UNKNOWN,
        spoofing=_SPOOFING[spoofing >> 1 & 7] if spoofing & 1 else _UNKNOWN,
    )


def _version(payload: bytes, *known: int) -> int:
    if not payload:
        raise UbxError("short")
    if payload[0] not in known:
        raise UbxError("version")
    return payload[0]


def _exactly(layout: struct.Struct, payload: bytes) -> tuple[int, ...]:
    if len(payload) != layout.size:
        raise UbxError("short")
    return layout.unpack(payload)


_DECODERS: dict[str, Callable[[bytes], Part]] = {
    "NAV-STATUS": _status,
    "NAV-CLOCK": _clock,
    "MON-RF": _radio_paths,
    "SEC-SIG": _security,
}
