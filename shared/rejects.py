"""Every reason of a reject, with its meaning and its remedy: those of the protocols, and those of the processes."""

from fnmatch import fnmatchcase

from .protocols.protocol import Reason
from .protocols.registry import PROTOCOLS

PAGE = "docs/reference/rejects.md"
_DAMAGE = "check ground and cable, and that the rate of the port carries what is sent"
_NONE = "none: it costs this item alone"
_CAUSE = "see the log of the process, and report it"
_SOURCE = "name the device that is meant in the vehicle file; unplug the other one"

# By the part of the unit in which they are counted.
OF_DEVICES = {
    "garbage_bytes": Reason("bytes between messages; a few at the start are usual", _DAMAGE),
    "cut_frame": Reason("a message without its end, with a complete one behind its beginning", _DAMAGE),
    "device_lost": Reason("a device that was unplugged, or whose server closed", "check cable, supply and address"),
    "write_lost": Reason("bytes for a device that is absent or takes none", "check the cable to the device"),
    "correction_lost": Reason("corrections that the receiver did not take", "raise the rate of its port"),
    "too_many_sources": Reason("more devices of a kind than are decoded", _SOURCE),
    "not_finite": Reason("an inertial measurement that is no number", "restart the device; replace it if it recurs"),
    "out_of_range": Reason("a measurement, or its time, that cannot be", "check units and columns in the vehicle file"),
    "repeated_sample": Reason("a second sample of one time", 'let the device send finer times, or write time = ""'),
    "incomplete_sample": Reason("UBX-ESF-RAW without all axes", "wait: the receiver sends them after its start"),
    "line": Reason("a line that is no CAN frame", "give a candump log, or check the adapter"),
    "line_stamp": Reason("a CAN frame whose time cannot be", "set the clock before recording"),
    "error_frame": Reason("an error frame of the CAN bus", "check bitrate, termination and wiring"),
    "dbc_frame": Reason("a frame that does not fit its message of the DBC file", "use the DBC file of this vehicle"),
    "signal_value": Reason("a signal beyond its range", "use the DBC file of this vehicle"),
    "wheel_speed": Reason("a wheel speed beyond its range", "use the DBC file of this vehicle"),
    "isotp_full": Reason("more answers in several frames at once than are kept", _NONE),
    "isotp_length": Reason("an answer in several frames that states too great a length", _NONE),
    "isotp_order": Reason("an answer in several frames one of which is missing", "check the load of the bus"),
    "isotp_timeout": Reason("an answer in several frames that did not end", "check the load of the bus"),
    "power_signal": Reason("a signal of a UPS that cannot be read", "check wiring and the section of the UPS"),
    "power_length": Reason("a reading of a UPS that ends within a value", "check its wiring and the configured type"),
    "power_overflow": Reason("a current beyond the range of the UPS's sensor", "check its wiring"),
    "power_range": Reason("a voltage beyond the range of the battery", "check wiring, cells and the configured type"),
    "power_step": Reason("a step of the voltage that the next readings do not confirm", "check its wiring"),
    "detector_line": Reason("a line of a detector that has another form", "compare the form in sensors.plaza"),
    "detector_lane": Reason("a pulse of a lane that the plaza does not have", "correct the lane's name"),
    "detector_rate": Reason("pulses of a lane faster than vehicles can pass", "check the detector"),
    "frame_rate": Reason("V2X frames beyond what a radio delivers", "check the link to the radio"),
    "frame_json": Reason(
        "a datagram of a udp+json radio that is no object with a frame", "compare the flow graph with connect-devices"
    ),
    "neighbour_unsigned": Reason(
        "an unsigned CAM of a station whose signed ones are received", "somebody sends under its identity"
    ),
    "neighbour_impossible": Reason("a CAM of a place or motion that cannot be", _NONE),
    "frame_length": Reason("a V2X frame without content, or longer than a frame can be", "check the link to the radio"),
    "queue_full": Reason("V2X frames that came faster than they are taken", "check the load of this computer"),
    "ubx_*": Reason("raw measurements that cannot be", "bring the receiver's firmware up to date"),
}
OF_V2X = {
    "batch": Reason("more frames in one message than are decoded", _NONE),
    "own_position": Reason("a CAM that cannot be made, since the unit has no position", "wait for a position"),
    "own_station": Reason("a CAM with the station ID of this unit", "give each unit a station ID of its own"),
    "too_far": Reason("a CAM of a station beyond `max_distance_m`", _NONE),
    "too_old": Reason("a CAM older than `max_age_s`", "check the clock of the unit and the link to the radio"),
    "from_the_future": Reason("a CAM generated later than now", "check the clock of the unit"),
    "header_time": Reason("a CAM repeated after its GeoNetworking time", _NONE),
    "security_algorithm": Reason("a signature or hash of an algorithm that is not known", _NONE),
    "security_content": Reason("a secured frame that is encrypted, or without signed content", _NONE),
    "security_encoding": Reason("a security header that is not encoded as its standard says", _NONE),
    "security_psid": Reason("a signed message of another service than CAM", _NONE),
    "security_header": Reason("a signed CAM with a member in its header that its profile excludes", _NONE),
    "bad_signature": Reason("a frame, or the ticket in it, that its stated key has not signed", _NONE),
    "expired": Reason("a signed frame whose ticket, or an issuer of it, is not valid now", "check the unit's clock"),
    "revoked": Reason("a signed frame of an authority that its root has revoked", _NONE),
    "wrong_permission": Reason("a signed frame with what its ticket, or an issuer of it, may not say", _NONE),
    "wrong_region": Reason(
        "a signed frame from outside the region of its ticket, or of an issuer of it",
        "state the country in `[parsers.v2x.security] countries`",
    ),
    "trust_file": Reason("a file of the trust folder that is not used; the log says why", "replace or remove the file"),
    "security_signer": Reason("a signed frame with neither a digest nor one explicit certificate", _NONE),
    "generation_time": Reason("a signed frame without time, or whose time contradicts its CAM", _NONE),
    "truncated": Reason("a frame that ends within its headers", "check the link to the radio"),
    "uper": Reason("a CAM that is not encoded as its standard says", _NONE),
    "*_version": Reason("a header of another version", "bring the radio's software up to date"),
    "message_id": Reason("a message that is no CAM", _NONE),
    "network_header": Reason("another next header", _NONE),
    "packet_type": Reason("another kind of GeoNetworking packet", _NONE),
    "port": Reason("another BTP port", _NONE),
    "transport": Reason("another kind of transport header", _NONE),
}
OF_CORE = {
    "bad_page": Reason("a broadcast page whose check failed", _NONE),
    "bad_subframe": Reason("a broadcast subframe whose parity failed", _NONE),
    "implausible_ephemeris": Reason("an ephemeris of no possible orbit", _NONE),
    "unknown_satellite": Reason("broadcast data of a satellite that is not numbered", _NONE),
    "second receiver": Reason("raw measurements of another receiver", _SOURCE),
    "*of a second source": Reason("a message of a second device of a kind", _SOURCE),
    "samples of a second imu": Reason("inertial samples of another unit", _SOURCE),
    "fix of a second receiver": Reason("a fix of a receiver that is not used", _SOURCE),
    "too many devices": Reason("more devices than the filter keeps errors of", _SOURCE),
    "confirmation of a position*": Reason(
        "the operator confirmed the position while GNSS contradicted other sensors", "confirm it after the conflict"
    ),
    "time line started again": Reason("a recording that begins again, or a host that was restarted", _NONE),
    "saved state*": Reason("a state of an earlier run that does not fit this one", "none: it is learned again"),
    "learned *": Reason("a learned value of another device or version", "none: it is learned again"),
    "filter state of another layout": Reason("a filter state of another version", "run one version of the unit"),
    "measurement from the future": Reason("a measurement stamped later than now", "check the clocks of the devices"),
    "fix from the future": Reason("a fix stamped later than now", "check the clock of this computer"),
    "fix without position": Reason("a fix without a position", "wait for satellites; check the antenna"),
    "measurement older than the memory": Reason("a measurement too late to be used", "check the load of this computer"),
    "held without inertial samples": Reason("a measurement for which no inertial sample came", "check the IMU"),
    "time lost as the inertial clock went back": Reason("the clock of the IMU went back", "check its supply"),
    "imu: *": Reason("inertial samples at the limit of the sensor", "mount it on a stiff place; choose a wider range"),
    "sample *": Reason("an inertial sample that is no number, doubled, late or early", "check the IMU and its port"),
    "implausible *": Reason("a sample or speed that no road vehicle has", "check units and mounting"),
    "gyroscope saturated": Reason("a rate at the limit of the sensor", "mount it on a stiff place"),
    "position *": Reason("a position that is no number, or next to a pole", "check the receiver"),
    "field of another strength than the Earth's": Reason("a disturbed magnetometer", "mount it away from iron"),
    "*is excluded by core.trust": Reason("a measurement of a device that is not trusted", "see the page Trust"),
    "tracks left out": Reason("tracks at the plaza beyond what one message holds", _NONE),
    "unknown monitor": Reason("a monitor that this version does not know", "run one version of the unit"),
}
OF_MONITORING = {
    "tariff class": Reason("a passage of a class without a tariff", "complete the tariff of the plaza"),
    "registration_without_ticket": Reason(
        "a registration of a station ID, which this plaza does not accept", "register the vehicle's ticket"
    ),
    "registration_validity": Reason("a registration for longer than one passage", "register for 10 minutes at most"),
    "registration_of_another_plaza": Reason("a registration for another plaza", "name this plaza in it"),
    "registration_not_possessed": Reason(
        "a registration without a good signature of the ticket's key", "sign with the key of the ticket; else a forgery"
    ),
    "registration_not_countersigned": Reason(
        "a registration without a good signature of the operator", "compare `operator_keys` in the plaza's file"
    ),
    "registration_changed": Reason("a stored registration that was changed beside the ledger", "see who has the disk"),
    "too many registrations": Reason("registrations beyond what the ledger keeps", "see who registers"),
    "crossings without a contract left out": Reason(
        "a crossing of a radio without a contract, beyond what the ledger judges at a time", "see who sends"
    ),
    "pulse of a closed hour": Reason(
        "a pulse that came after its hour was closed", "look at the detector's connection"
    ),
    "outcome of a closed hour": Reason("an outcome that came after its hour was closed", _NONE),
    "payment in a lane for C-ITS only": Reason("a payment of a lane that is not mixed", "correct the plaza's file"),
    "seal_file": Reason("a signed entry that could not be written", "check the folder of `seal_file`"),
    "passages left out": Reason("the oldest of more open passages than one message holds", _NONE),
    "outages left out": Reason("outages of a replay beyond what one message holds", _NONE),
    "another plaza": Reason("a passage of another plaza", "give the road-side unit the file of its plaza"),
    "receipt of an unknown transaction": Reason("a receipt without a transaction", "report it with the recording"),
    "database": Reason("an entry that the ledger's database refused", "free the disk; see the log"),
    "replay": Reason("a message of a replay, which is not booked or reported", _NONE),
    "too_many_clients": Reason("more connections than `clients_maximum`", "raise it, or close programs"),
    "accept": Reason("a connection that could not be accepted", "raise the limit of open files"),
    "datagram_lost": Reason("a datagram that the network did not take", "check the address of the output"),
    "flood": Reason("messages beyond the lasting rate of a topic, not recorded", "find what publishes them"),
    "*of the centre": Reason("a message of the centre that cannot be read, or too many", "bring both to one version"),
    "live message": Reason("a message that does not fit into the live report", _NONE),
    "clock jump": Reason("a step of this computer's clock", "let NTP or the receiver set it"),
    "watch": Reason("a request to watch that is not valid", "bring unit and centre to one version"),
    "receipt*": Reason("a receipt without its batch, or one that cannot be read", "bring both to one version"),
    "unusable report": Reason("a report that its schema refuses", _CAUSE),
    "outbox": Reason("a report that the outbox did not take", "free the disk"),
    "lost event": Reason("an event that the outbox had no room for", "free the disk; restore the connection"),
}
OF_BUS = {
    "payload": Reason("a message that breaks its contract", "bring the program that sends it to this version"),
    "envelope": Reason("a message without sender or topic", "as payload"),
    "sender": Reason("a message of a program that may not send it", "check the names and secrets of the bus"),
    "too large": Reason("a message longer than its topic holds, which was not sent", _CAUSE),
    "refused": Reason("a subscription or message that the broker refuses", "run `obu keys`, then restart the broker"),
    "stamp": Reason("a message stamped before 1980 or after 2100", "set the clock of this computer"),
    "input too old": Reason("an input skipped because the process is too far behind", "use a faster computer"),
    "range": Reason("a value that the message model refuses", "check the device that sends it"),
    "fault": Reason("an error of the program while one item was handled", _CAUSE),
    "state disk": Reason("a state that could not be written", "free the disk; check its rights"),
    "late": Reason("a step of the simulator that came too late", "use a faster computer"),
    "send": Reason("a message of the traffic that was not sent", "check the broker"),
}
PARTS = {
    **{protocol.title: protocol.reasons for protocol in PROTOCOLS if protocol.reasons},
    "Devices": OF_DEVICES, "V2X": OF_V2X, "Core": OF_CORE, "Monitoring": OF_MONITORING, "Bus": OF_BUS,
}  # fmt: skip


def reason_of(kind: str) -> Reason | None:
    """The reason of a kind of reject, by its name, then by a pattern; None of one that is not in the table."""
    for reasons in PARTS.values():
        if kind in reasons:
            return reasons[kind]
    patterns = ((name, reason) for reasons in PARTS.values() for name, reason in reasons.items() if "*" in name)
    return next((reason for name, reason in patterns if fnmatchcase(kind, name)), None)
