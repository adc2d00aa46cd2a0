"""What an error of a connection means, in words: those of OpenSSL name lines of its source."""

import ssl

NO_TLS = "it does not speak TLS, so it is another kind of server, or another port"
WORDS = {
    "WRONG_VERSION_NUMBER": NO_TLS,
    "RECORD_LAYER_FAILURE": NO_TLS,
    "PACKET_LENGTH_TOO_LONG": NO_TLS,
    "UNEXPECTED_EOF_WHILE_READING": "it ended the connection without an answer",
    "TLSV13_ALERT_CERTIFICATE_REQUIRED": "it asks for a certificate of its own, so it is another kind of server",
    "SSLV3_ALERT_BAD_CERTIFICATE": "it refuses the certificate, or asks for one",
    "SSLV3_ALERT_HANDSHAKE_FAILURE": "it agrees to no TLS that this program has",
    "TLSV1_ALERT_PROTOCOL_VERSION": "it has another version of TLS",
    "UNSUPPORTED_PROTOCOL": "it has an old version of TLS alone",
}


def reason_of(error: Exception) -> str:
    """Say why there is no connection, without names of OpenSSL where they are known."""
    if isinstance(error, ssl.SSLCertVerificationError):
        return f"its certificate is not accepted: {error.verify_message.rstrip('.')}"
    if isinstance(error, ssl.SSLError) and error.reason:
        return WORDS.get(error.reason) or f"TLS fails: {error.reason.lower().replace('_', ' ')}"
    if isinstance(error, TimeoutError) and not str(error):
        return "it does not answer in time"
    return getattr(error, "strerror", None) or str(error) or type(error).__name__
