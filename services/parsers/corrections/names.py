"""Names of the kinds of frames, for counters that a person reads.

References
----------
RTCM 10403.3, table 3.1-1: message types. SPARTN interface control document, version 2.0, tables of TF002 and TF003.
"""

from functools import lru_cache

from shared.messages.corrections import CorrectionProtocol

_MSM = {107: "GPS", 108: "GLONASS", 109: "Galileo", 110: "SBAS", 111: "QZSS", 112: "BeiDou", 113: "NavIC"}
_RTCM = {
    **dict.fromkeys(range(1001, 1005), "GPS observations"),
    **dict.fromkeys((1005, 1006), "station position"),
    **dict.fromkeys((1007, 1008), "station antenna"),
    **dict.fromkeys(range(1009, 1013), "GLONASS observations"),
    1013: "system parameters",
    **dict.fromkeys(range(1014, 1018), "GPS network corrections"),
    1019: "GPS ephemeris",
    1020: "GLONASS ephemeris",
    **dict.fromkeys(range(1021, 1028), "transformation"),
    1029: "text",
    **dict.fromkeys((1030, 1031), "network residuals"),
    1032: "reference station position",
    1033: "station receiver",
    **dict.fromkeys((1034, 1035), "network gradients"),
    **dict.fromkeys(range(1037, 1040), "GLONASS network corrections"),
    1041: "NavIC ephemeris",
    1042: "BeiDou ephemeris",
    1044: "QZSS ephemeris",
    **dict.fromkeys((1045, 1046), "Galileo ephemeris"),
    **dict.fromkeys(range(1057, 1063), "GPS SSR"),
    **dict.fromkeys(range(1063, 1069), "GLONASS SSR"),
    1230: "GLONASS biases",
    4072: "u-blox",
    4076: "IGS SSR",
}
_SPARTN = {0: "OCB", 1: "HPAC", 2: "GAD", 3: "BPAC", 4: "EAS", 120: "proprietary"}
_SPARTN_SYSTEMS = ("GPS", "GLONASS", "Galileo", "BeiDou", "QZSS")  # subtypes of OCB and HPAC
_UBX = {(0x02, 0x72): "RXM-PMP", (0x02, 0x36): "RXM-SPARTNKEY"}


@lru_cache(maxsize=128)
def name_of(protocol: CorrectionProtocol, kind: tuple[int, int]) -> str:
    """Name a kind of frame: "RTCM 1077 GPS MSM7", "SPARTN OCB GPS", "UBX RXM-PMP"."""
    number, subtype = kind
    if protocol is CorrectionProtocol.RTCM3:
        system = _MSM.get(number // 10)
        msm = f"{system} MSM{number % 10}" if system and 1 <= number % 10 <= 7 else ""
        return f"RTCM {number} {msm or _RTCM.get(number, '')}".rstrip()
    if protocol is CorrectionProtocol.UBX:
        return f"UBX {_UBX[kind]}"
    system = _SPARTN_SYSTEMS[subtype] if number in (0, 1) and subtype < len(_SPARTN_SYSTEMS) else ""
    return f"SPARTN {_SPARTN[number]} {system}".rstrip()
