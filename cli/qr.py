"""QR codes in a terminal: of a login, and of the Wi-Fi network that deploy/install.sh has set up."""

import configparser
import re
import sys
from pathlib import Path

_ESCAPES = {"s": " ", "t": "\t", "n": "\n", "r": "\r"}


def show(text: str) -> None:
    """Print a text as a QR code of half blocks, dark on light whatever the colours of the terminal."""
    import segno  # by who asks for a code alone

    segno.make(text, error="m").terminal(compact=True)


def wifi_text(ssid: str, passphrase: str) -> str:
    """Text of a code by which phones join a network with WPA2."""
    from segno import helpers

    return helpers.make_wifi_data(ssid, passphrase, "WPA")


def network_of(connection: str) -> tuple[str, str]:
    """Name and passphrase of the network in a connection file of NetworkManager.

    Raises
    ------
    ValueError
        If the text is no such file.
    """
    parser = configparser.ConfigParser(interpolation=None)
    try:
        parser.read_string(connection)
        return name_of(parser["wifi"]["ssid"]), _unescaped(parser["wifi-security"]["psk"])
    except (configparser.Error, KeyError) as error:
        raise ValueError("it is no connection of NetworkManager with a passphrase") from error


def name_of(written: str) -> str:
    """Name of a network as a connection file has it: a text with escapes, or its bytes as a list of numbers.

    References
    ----------
    nm-settings-keyfile(5): `ssid=Home` or `ssid=72;111;109;101;`; a semicolon in a text has a backslash before it.
    """
    numbers = [int(digits) for digits in re.findall(r"\d+", written)]
    if re.fullmatch(r"(?:\d{1,3} *; *){1,32}", written) and max(numbers) < 256:
        return bytes(numbers).decode("utf-8", "replace")
    return _unescaped(written)


def _unescaped(written: str) -> str:
    """Text without the escapes of GLib's key files, which are a backslash and s, t, n, r or the character."""
    return re.sub(r"\\(.)", lambda found: _ESCAPES.get(found[1], found[1]), written)


def main() -> int:
    """`python -m cli.qr --wifi FILE`: print a network's code, its name and its passphrase."""
    if len(sys.argv) != 3 or sys.argv[1] != "--wifi":
        sys.stderr.write("usage: python -m cli.qr --wifi FILE\n")
        return 2
    try:
        ssid, passphrase = network_of(Path(sys.argv[2]).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        sys.stderr.write(f"cannot read {sys.argv[2]}: {error}\n")
        return 1
    show(wifi_text(ssid, passphrase))
    print(f"network      {ssid}\npassphrase   {passphrase}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
