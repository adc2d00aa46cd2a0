#!/bin/sh
# Installs the programs required by the tests on Debian; on other systems prints the missing ones.
# Usage: install_test_programs.sh [SUDO]
set -u
sudo=${1:-}
missing=
for pair in mosquitto:mosquitto mosquitto_pub:mosquitto-clients gpsd:gpsd gpspipe:gpsd-clients tshark:tshark gpsbabel:gpsbabel cc:gcc str2str:rtklib busybox:busybox systemd-analyze:systemd; do
    program=${pair%%:*}
    command -v "$program" >/dev/null 2>&1 || [ -x "/usr/sbin/$program" ] || missing="$missing ${pair#*:}"
done
[ -e /usr/include/mosquitto.h ] || missing="$missing libmosquitto-dev"
command -v runuser >/dev/null 2>&1 || missing="$missing util-linux"
# Chromium without its window, which costs about half; not every distribution has a package of it.
browser=
command -v chromium-headless-shell >/dev/null 2>&1 || command -v chromium >/dev/null 2>&1 || browser=chromium
# The server of a centre; its package would make and start a cluster of its own on port 5432.
postgres=
[ -n "$(ls /usr/share/postgresql/*/extension/postgis.control 2>/dev/null)" ] || postgres=postgresql-15-postgis-3
# nginx is unpacked into this folder and not installed: its package would start a web server.
unpacked=$(cd "$(dirname "$0")/.." && pwd)/.obu/test-programs
nginx=
command -v nginx >/dev/null 2>&1 || [ -x /usr/sbin/nginx ] || [ -x "$unpacked/usr/sbin/nginx" ] || nginx=nginx
[ -n "$missing$browser$nginx$postgres" ] || exit 0
if ! command -v apt-get >/dev/null 2>&1; then
    echo "not installed, their tests will skip:$missing $browser $nginx $postgres"
    exit 0
fi
$sudo env DEBIAN_FRONTEND=noninteractive apt-get -qq update
if [ -n "$browser" ]; then
    apt-cache show chromium-headless-shell >/dev/null 2>&1 && browser=chromium-headless-shell
    missing="$missing $browser"
fi
echo "installing for the tests:$missing $nginx $postgres"
if [ -n "$missing" ]; then
    # shellcheck disable=SC2086
    $sudo env DEBIAN_FRONTEND=noninteractive apt-get -qq install -y --no-install-recommends $missing >/dev/null ||
        echo "could not install$missing: their tests will skip"
fi
if [ -n "$postgres" ]; then
    no_cluster=/etc/postgresql-common/createcluster.d/obu-tests.conf
    $sudo mkdir -p "${no_cluster%/*}"
    echo "create_main_cluster = false" | $sudo tee "$no_cluster" >/dev/null
    $sudo env DEBIAN_FRONTEND=noninteractive apt-get -qq install -y --no-install-recommends "$postgres" >/dev/null ||
        echo "could not install $postgres: the tests of a control centre will skip"
fi
if [ -n "$nginx" ]; then
    mkdir -p "$unpacked"
    (cd "$unpacked" && apt-get -qq download nginx && dpkg -x nginx_*.deb . && rm nginx_*.deb) ||
        echo "could not unpack nginx: its tests will skip"
fi
