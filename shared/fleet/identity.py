"""Who a unit is for its control centre: files that `obu enrol` writes and a renewal replaces.

In the folder: `tls.pem`, private key and certificate in one file so that they are replaced together; `ca.pem`, the
centre's authority; `centre.json`, its addresses and the unit's name there.
"""

import json
import os
import secrets
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

from ..bounded import SizeExceeded, read_bytes
from ..errors import UserError
from ..runtime.private import UPLINK, private_folder
from .topics import VEHICLE

NS = 1_000_000_000
DAY_NS = 86_400 * NS
RENEW_BEFORE_NS = 10 * DAY_NS  # of the 30 days of a certificate
MAX_BYTES = 65_536
TLS, AUTHORITY, CENTRE = "tls.pem", "ca.pem", "centre.json"


@dataclass(frozen=True)
class Centre:
    """What the centre has said of itself and of this unit."""

    vehicle: str
    tenant: str
    host: str  # of the MQTT listener
    mqtt_port: int
    renew_url: str
    evidence_key: str  # key id that is registered
    not_before_ns: int  # of the certificate, UTC
    not_after_ns: int


@dataclass(frozen=True)
class UplinkIdentity:
    """The enrolment of a unit."""

    folder: Path
    centre: Centre

    @property
    def tls(self) -> Path:
        """Private key and certificate."""
        return self.folder / TLS

    @property
    def authority(self) -> Path:
        """The centre's authority, by which its servers are known."""
        return self.folder / AUTHORITY

    def renewal_due(self, utc_ns: int, evidence_key: str) -> bool:
        """Whether the certificate ends within 10 days, has ended, or another evidence key is in use."""
        return utc_ns >= self.centre.not_after_ns - RENEW_BEFORE_NS or evidence_key != self.centre.evidence_key

    @classmethod
    def read(cls, folder: Path) -> "UplinkIdentity":
        """Read an enrolment; raises `UserError` if there is none or it is damaged."""
        path = folder / CENTRE
        try:
            content = json.loads(read_bytes(path, MAX_BYTES))
            centre = Centre(**{name: kind(content[name]) for name, kind in Centre.__annotations__.items()})
            for name in (TLS, AUTHORITY):
                with (folder / name).open("rb"):
                    pass
        except FileNotFoundError as error:
            raise UserError(
                "this unit is not enrolled at a centre: run `obu enrol URL TOKEN` with a token of the centre"
            ) from error
        except OSError as error:
            raise UserError(f"cannot read {error.filename}: {error.strerror}; check its owner") from error
        except (SizeExceeded, ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
            raise UserError(f"{path} is damaged: {error}; run `obu enrol URL TOKEN` again") from error
        if not VEHICLE.fullmatch(centre.vehicle) or not 0 < centre.mqtt_port < 65536:
            raise UserError(f"{path} names no possible vehicle or port; run `obu enrol URL TOKEN` again")
        return cls(folder, centre)


def identity_folder(state: Path) -> Path:
    """Folder of the enrolment; where each process has a user of its own, only monitoring.uplink may look into it."""
    return private_folder(state) / UPLINK


def write_identity(folder: Path, centre: Centre, key_and_certificate: str, authority: str) -> UplinkIdentity:
    """Replace the enrolment in a folder; raises `UserError` where that cannot be written.

    The last file is the one that is read first, so that a half written enrolment is none.
    """
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        for name, text in (
            (AUTHORITY, authority), (TLS, key_and_certificate), (CENTRE, json.dumps(asdict(centre), indent=1)),
        ):  # fmt: skip
            _write(folder / name, text)
    except OSError as error:
        raise UserError(f"cannot write into {folder}: {error.strerror}; check its owner and its disk") from error
    return UplinkIdentity(folder, centre)


def _write(path: Path, text: str) -> None:
    """Write a file of the folder's owner in one piece, and to the disk."""
    draft = path.with_name(f".{path.name}.{os.getpid()}.{secrets.token_hex(4)}")
    descriptor = os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o400)
    with os.fdopen(descriptor, "w", encoding="utf-8") as file:
        if os.geteuid() == 0:  # `obu enrol` by root, for a process with a user of its own
            owner = path.parent.stat()
            os.fchown(file.fileno(), owner.st_uid, owner.st_gid)
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    draft.replace(path)


def date_of(ns: int) -> str:
    """Write a time [ns, UTC] for people."""
    return f"{datetime.fromtimestamp(ns / NS, UTC):%Y-%m-%d %H:%M} UTC"
