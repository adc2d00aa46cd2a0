"""Signs what web hooks are sent, as the Standard Webhooks specification 1.0 says.

Whoever knows the address of a hook could send alarms to it; its server compares the signature, which needs the secret,
and refuses stamps that are older than five minutes. Libraries for it exist in most languages.
"""

import base64
import hmac
import secrets

PREFIX = "whsec_"
KEY_BYTES = 24


def new_secret() -> str:
    """Make a secret that centre and hook share: `whsec_` and the key in base64."""
    return PREFIX + base64.b64encode(secrets.token_bytes(KEY_BYTES)).decode()


def signed_headers(secret: str, message: str, now_s: int, body: bytes) -> dict[str, str]:
    """Headers of a message.

    Parameters
    ----------
    secret : str
        From `new_secret`.
    message : str
        What it is called; a repetition has the same name.
    now_s : int
        Time of this attempt [s, UTC].
    body : bytes
        Exactly as it is sent.
    """
    key = base64.b64decode(secret.removeprefix(PREFIX))
    digest = hmac.digest(key, f"{message}.{now_s}.".encode() + body, "sha256")
    return {
        "webhook-id": message,
        "webhook-timestamp": str(now_s),
        "webhook-signature": f"v1,{base64.b64encode(digest).decode()}",
    }
