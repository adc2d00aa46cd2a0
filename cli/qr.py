"""QR codes in a terminal: of a login, and of the Wi-Fi network that deploy/install.sh has set up."""

import configparser
import sys
from pathlib import Path


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
        return parser["wifi"]["ssid"], parser["wifi-security"]["psk"]
    except (configparser.Error, KeyError) as error:
        raise ValueError("it is no connection of NetworkManager with a passphrase") from error


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
