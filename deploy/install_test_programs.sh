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
[ -n "$missing" ] || exit 0
if ! command -v apt-get >/dev/null 2>&1; then
    echo "not installed, their tests will skip:$missing"
    exit 0
fi
echo "installing for the tests:$missing"
export DEBIAN_FRONTEND=noninteractive
# shellcheck disable=SC2086
$sudo env DEBIAN_FRONTEND=noninteractive apt-get -qq update &&
    $sudo env DEBIAN_FRONTEND=noninteractive apt-get -qq install -y --no-install-recommends $missing >/dev/null ||
    echo "could not install$missing: their tests will skip"
