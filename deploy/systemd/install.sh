#!/usr/bin/env bash
# Install the unit's services on a Debian system such as Raspberry Pi OS: `sudo deploy/systemd/install.sh`.
# The repository is at /opt/obu and `make setup` has run there. May be run again: settings in /etc/obu are kept.
set -euo pipefail
cd "$(dirname "$0")/../.."

[ "$(id -u)" = 0 ] || { echo "root rights are required: run it with sudo"; exit 1; }
[ "$PWD" = /opt/obu ] || { echo "the repository must be at /opt/obu, not at $PWD: move it there"; exit 1; }
[ -x .venv/bin/python ] || { echo "the Python packages are missing: run make setup first"; exit 1; }
[ -x /usr/sbin/mosquitto ] || { echo "the broker is missing: apt install mosquitto"; exit 1; }

getent group obu-evidence >/dev/null || groupadd --system obu-evidence # may read the key that signs
getent group i2c >/dev/null || groupadd --system i2c # of the I2C bus, for sensors.power
id obu >/dev/null 2>&1 || useradd --system --home-dir /var/lib/obu --shell /usr/sbin/nologin obu

install -d -m 755 /etc/obu
[ -e /etc/obu/vehicle.toml ] || install -m 644 deploy/vehicles/pi.toml /etc/obu/vehicle.toml
[ -e /etc/obu/obu.env ] || install -m 644 deploy/systemd/obu.env /etc/obu/obu.env
# A listener for other machines stays (docs/how-to/connect-programs-to-the-bus.md).
listen=$(sed -n 's/^listener 8883 //p' /etc/obu/mosquitto.conf 2>/dev/null || true)
.venv/bin/python -m broker.local_config --store /var/lib/obu-broker --rules /etc/obu/broker \
    ${listen:+--listen "$listen"} >/etc/obu/mosquitto.conf.part
mv /etc/obu/mosquitto.conf.part /etc/obu/mosquitto.conf

# A user for each process: none can read the secret of another. They share the state folder by their group.
[ -d /var/lib/obu ] || install -d -m 2770 -g obu /var/lib/obu
install -d -m 755 /var/lib/obu-private # root's: secrets, the key that signs, tokens of the page
for name in $(.venv/bin/python -c 'from shared.processes import *; print(*(row.name for row in PROCESSES))'); do
    user=obu-${name//[._]/-}
    id "$user" >/dev/null 2>&1 ||
        useradd --system --gid obu --home-dir /var/lib/obu --no-create-home --shell /usr/sbin/nologin "$user"
    install -d -m 755 "/etc/systemd/system/obu@$name.service.d"
    printf '[Service]\nUser=%s\n' "$user" >"/etc/systemd/system/obu@$name.service.d/user.conf"
done
# The first secrets, and those of the files of an earlier version; obu-broker.service does it again at each start.
OBU_VEHICLE=/etc/obu/vehicle.toml OBU_STATE=/var/lib/obu .venv/bin/python -m cli keys make \
    --broker-files /etc/obu/broker --broker-user mosquitto --group obu

cp -r deploy/systemd/{obu,rsu}.target deploy/systemd/obu-broker.service deploy/systemd/obu-switched.* deploy/systemd/obu@* /etc/systemd/system/
# Some kernels give no real-time priority to services (CONFIG_RT_GROUP_SCHED): Nice=-10 is used instead.
if ! chrt --rr 1 true 2>/dev/null; then
    echo "no real-time priority for services with this kernel: the hot path gets Nice=-10"
    grep -rl '^CPUSchedulingPolicy=rr$' /etc/systemd/system/obu* |
        xargs sed -i -e 's/^CPUSchedulingPolicy=rr$/Nice=-10/' -e '/^CPUSchedulingPriority=/d'
fi
install -m 644 -D deploy/udev/99-obu.rules /etc/udev/rules.d/99-obu.rules
if command -v udevadm >/dev/null; then udevadm control --reload && udevadm trigger; fi

systemctl daemon-reload
systemctl disable --quiet --now mosquitto.service
# The role of the unit's file decides which target is started.
role=$(.venv/bin/python -c 'from shared.runtime.config import *; print(load_vehicle("/etc/obu/vehicle.toml").role)')
systemctl disable --quiet --now "$([ "$role" = obu ] && echo rsu || echo obu).target"
# In addition to those of the target, processes with a section in the settings are enabled.
OBU_VEHICLE=/etc/obu/vehicle.toml OBU_STATE=/var/lib/obu deploy/systemd/switch.sh enable
systemctl enable --quiet "$role.target" obu-switched.path
systemctl restart --no-block "$role.target" # a process that cannot start would hold this up without end
[ -z "${OBU_NO_LINK:-}" ] || exit 0
echo "to log in on its page (docs/how-to/let-others-look.md):"
OBU_VEHICLE=/etc/obu/vehicle.toml OBU_STATE=/var/lib/obu .venv/bin/python -m cli token show-link || true
echo "the unit runs; status: 'systemctl list-dependencies $role.target', logs: 'journalctl -fu \"obu@*\"'"
