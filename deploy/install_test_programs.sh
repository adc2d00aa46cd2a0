#!/bin/sh
# Installs the programs required by the tests on Debian; on other systems prints the missing ones.
# Usage: install_test_programs.sh [SUDO]
set -u
sudo=${1:-}
missing=
for pair in mosquitto:mosquitto mosquitto_pub:mosquitto-clients chromium:chromium gpsd:gpsd gpspipe:gpsd-clients tshark:tshark gpsbabel:gpsbabel cc:gcc str2str:rtklib busybox:busybox; do
    program=${pair%%:*}
    command -v "$program" >/dev/null 2>&1 || [ -x "/usr/sbin/$program" ] || missing="$missing ${pair#*:}"
done
[ -e /usr/include/mosquitto.h ] || missing="$missing libmosquitto-dev"
# nginx is unpacked into this folder and not installed: its package would start a web server.
unpacked=$(cd "$(dirname "$0")/.." && pwd)/.obu/test-programs
nginx=
command -v nginx >/dev/null 2>&1 || [ -x /usr/sbin/nginx ] || [ -x "$unpacked/usr/sbin/nginx" ] || nginx=nginx
[ -n "$missing$nginx" ] || exit 0
if ! command -v apt-get >/dev/null 2>&1; then
    echo "not installed, their tests will skip:$missing $nginx"
    exit 0
fi
echo "installing for the tests:$missing $nginx"
$sudo env DEBIAN_FRONTEND=noninteractive apt-get -qq update
if [ -n "$missing" ]; then
    # shellcheck disable=SC2086
    $sudo env DEBIAN_FRONTEND=noninteractive apt-get -qq install -y --no-install-recommends $missing >/dev/null ||
        echo "could not install$missing: their tests will skip"
fi
if [ -n "$nginx" ]; then
    mkdir -p "$unpacked"
    (cd "$unpacked" && apt-get -qq download nginx && dpkg -x nginx_*.deb . && rm nginx_*.deb) ||
        echo "could not unpack nginx: its tests will skip"
fi
