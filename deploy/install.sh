#!/bin/sh
# Installs the unit on Raspberry Pi OS or Debian, 12 or 13, by one line:
#
#   curl -fsSL <address of this file> | sudo sh -s -- --from <address of the repository>
#
# or from a copy of the repository: sudo sh deploy/install.sh. `--help` lists what it can do besides.
# Everything is in functions, so that a download that breaks off runs nothing.
set -eu

UNIT=/opt/obu CONFIG=/etc/obu STATE=/var/lib/obu SECRETS=/var/lib/obu-private COMMAND=/usr/local/bin/obu
BACKUPS=/var/backups/obu
ACCESS_POINT=/etc/NetworkManager/system-connections/obu-access-point.nmconnection
NAME=/etc/avahi/services/obu.service
PORT=8080
LOG=${OBU_INSTALL_LOG:-/var/log/obu-install.log}
ROOM_MB=2000 # packages, and what pip unpacks meanwhile
STEPS=7 START_S=120 # until the page answers

help() {
    cat <<'TEXT'
Usage: sudo sh install.sh [install|upgrade|remove] [options]

  install             install the unit, or finish an installation that broke off (the default)
  upgrade             install the newest version, and go back to the former one where the unit does not come up
  remove              remove the unit; settings, drives and keys stay, unless --purge is given

  --from ADDRESS      repository or folder to install from; without it, the one that holds this script
  --version NAME      tag or branch; without it the newest state of the repository's main branch
  --simulated         drive a simulated car: everything works without devices
  --local             let only this machine open the page; without it every machine in the unit's networks may ask
                      for it, and has to log in
  --access-point SSID open a Wi-Fi network of the unit's own, with a passphrase made for it (NetworkManager)
  --interface NAME    Wi-Fi interface of the access point; without it wlan0
  --purge             with remove: also delete settings, drives, keys and backups

Examples:
  sudo sh install.sh --simulated
  sudo sh install.sh --access-point "OBU truck 7"
  sudo obu-install upgrade
TEXT
}

fail() {
    echo "install: $1" >&2
    exit "${2:-1}"
}

step() {
    number=$((number + 1))
    echo "$number/$STEPS $1"
}

# Run a command whose output goes to the log; where it fails, its end is shown.
quietly() {
    echo "\$ $*" >>"$LOG"
    if ! "$@" >>"$LOG" 2>&1; then
        tail -n 15 "$LOG" >&2
        fail "this failed: $*
install: the whole output is in $LOG; the same command goes on where it stopped"
    fi
}

system_of() { # key of os-release
    sed -n "s/^$1=//p" "${OBU_OS_RELEASE:-/etc/os-release}" | tr -d '"'
}

check_machine() {
    case " $(system_of ID) $(system_of ID_LIKE) " in
    *" debian "*) ;;
    *) fail "this is $(system_of PRETTY_NAME): Debian or Raspberry Pi OS, 12 or 13, is needed; elsewhere use containers (docs/how-to/run-in-containers.md)" ;;
    esac
    release=$(system_of VERSION_ID)
    [ "${release%%.*}" -ge 12 ] 2>/dev/null ||
        fail "this is $(system_of PRETTY_NAME): its Python is older than 3.11; install Debian or Raspberry Pi OS 12 or 13"
    [ "$(getconf LONG_BIT)" = 64 ] || fail "this system has 32 bit; install the one with 64 bit"
    [ "$(id -u)" = 0 ] || fail "root rights are needed: run it with sudo"
    command -v systemctl >/dev/null || fail "there is no systemd; use containers (docs/how-to/run-in-containers.md)"
    free_mb=$(df -Pm /opt | awk 'NR == 2 { print $4 }')
    [ "$free_mb" -ge "$ROOM_MB" ] || [ -d "$UNIT/.venv" ] ||
        fail "/opt has room for $free_mb MB, $ROOM_MB are needed: remove files, or use a larger card"
}

install_packages() {
    step "Debian's packages (log: $LOG)"
    wanted="git make mosquitto python3-venv ca-certificates avahi-daemon chrony"
    [ -z "$ssid" ] || wanted="$wanted network-manager wpasupplicant"
    missing=
    for package in $wanted; do
        dpkg-query -W -f '${Status}' "$package" 2>/dev/null | grep -q 'ok installed' || missing="$missing $package"
    done
    [ -n "$missing" ] || return 0
    quietly apt-get -qq update
    # shellcheck disable=SC2086
    quietly env DEBIAN_FRONTEND=noninteractive apt-get -qq install -y --no-install-recommends $missing
}

# git refuses a repository of another user, such as the one who called sudo: we only read it.
git_of_others() {
    home=$(mktemp -d)
    printf '[safe]\n\tdirectory = *\n' >"$home/.gitconfig"
    result=0
    HOME=$home git "$@" >>"$LOG" 2>&1 || result=$?
    rm -r "$home"
    return "$result"
}

fetch_unit() {
    step "the unit, from $from"
    if [ "$from" != "$UNIT" ]; then
        if [ ! -d "$UNIT/.git" ]; then
            [ ! -e "$UNIT" ] || [ -z "$(ls -A "$UNIT")" ] || fail "$UNIT exists and is no repository: move it away"
            quietly git init --quiet "$UNIT"
            quietly git -C "$UNIT" remote add origin "$from"
        fi
        git_of_others -C "$UNIT" fetch --quiet --tags "$from" "${version:-HEAD}" ||
            fail "cannot fetch ${version:-the newest version} from $from; is the address right, and the network there? ($LOG)"
        quietly git -C "$UNIT" checkout --quiet --force --detach FETCH_HEAD
    elif [ -n "$version" ]; then
        quietly git -C "$UNIT" checkout --quiet --force "$version"
    fi
    chown -R root:root "$UNIT"
}

build() {
    step "Python packages and the page's libraries (one to ten minutes)"
    quietly make -C "$UNIT" setup
}

configure() {
    step "settings in $CONFIG"
    install -d -m 755 "$CONFIG"
    if [ ! -e "$CONFIG/vehicle.toml" ]; then
        source=pi
        [ -z "$simulated" ] || source=simulated
        install -m 644 "$UNIT/deploy/vehicles/$source.toml" "$CONFIG/vehicle.toml"
        [ -z "$simulated" ] || install -m 644 "$UNIT/deploy/vehicles/simulated.dbc" "$CONFIG/simulated.dbc"
    elif [ -n "$simulated" ] && ! grep -q '^\[sensors.simulator' "$CONFIG/vehicle.toml"; then
        fail "$CONFIG/vehicle.toml is that of a vehicle with devices: move it away for a simulated one"
    else
        quietly "$UNIT/.venv/bin/python" -m cli migrate "$CONFIG/vehicle.toml"
    fi
    if [ ! -e "$CONFIG/obu.env" ]; then
        install -m 644 "$UNIT/deploy/systemd/obu.env" "$CONFIG/obu.env"
        [ -n "$local_only" ] || sed -i 's/^OBU_HTTP_HOST=.*/OBU_HTTP_HOST=0.0.0.0/' "$CONFIG/obu.env"
    fi
    cat >"$COMMAND" <<'TEXT'
#!/bin/sh
# The unit's commands, with the folders of its services where this user may read them. Written by deploy/install.sh.
if [ -r /var/lib/obu ]; then
    : "${OBU_STATE:=/var/lib/obu}" "${OBU_BROKER:=mqtt+unix:///run/obu-broker/socket}"
    export OBU_STATE OBU_BROKER
fi
[ ! -r /etc/obu/vehicle.toml ] || export OBU_VEHICLE="${OBU_VEHICLE:-/etc/obu/vehicle.toml}"
exec /opt/obu/.venv/bin/obu "$@"
TEXT
    chmod 755 "$COMMAND"
    printf '#!/bin/sh\nexec sh %s/deploy/install.sh "$@"\n' "$UNIT" >"$COMMAND-install"
    chmod 755 "$COMMAND-install"
}

start_services() {
    step "services of systemd"
    quietly env OBU_NO_LINK=1 "$UNIT/deploy/systemd/install.sh" # a login does not belong into a log
}

announce() {
    step "name and networks"
    install -d -m 755 "${NAME%/*}"
    cat >"$NAME" <<TEXT
<?xml version="1.0" standalone="no"?>
<!DOCTYPE service-group SYSTEM "avahi-service.dtd">
<service-group>
  <name replace-wildcards="yes">On-board unit %h</name>
  <service><type>_http._tcp</type><port>$PORT</port></service>
</service-group>
TEXT
    for service in avahi-daemon chrony; do
        systemctl enable --quiet --now "$service" >>"$LOG" 2>&1 || echo "    $service does not start; see: systemctl status $service"
    done
    [ -n "$ssid" ] || return 0
    if [ ! -e "$ACCESS_POINT" ]; then
        passphrase=$(LC_ALL=C tr -dc 'a-km-np-z2-9' </dev/urandom | head -c 16)
        (
            umask 077
            mkdir -p "${ACCESS_POINT%/*}"
            nmcli --offline connection add type wifi con-name obu-access-point ifname "$interface" ssid "$ssid" \
                autoconnect yes wifi.mode ap wifi.band bg wifi-sec.key-mgmt wpa-psk wifi-sec.proto rsn \
                wifi-sec.pairwise ccmp wifi-sec.group ccmp wifi-sec.psk "$passphrase" \
                ipv4.method shared ipv4.addresses 10.42.7.1/24 ipv6.method disabled >"$ACCESS_POINT.part"
        ) || fail "NetworkManager refused the access point; is its name at most 32 characters long?"
        mv "$ACCESS_POINT.part" "$ACCESS_POINT"
    fi
    if nmcli connection reload >>"$LOG" 2>&1 && nmcli connection up obu-access-point >>"$LOG" 2>&1; then
        echo "    Wi-Fi network \"$ssid\" is open"
    else
        echo "    Wi-Fi network \"$ssid\" is set up, and does not start yet: is $interface a Wi-Fi interface that NetworkManager runs?"
    fi
}

alive() { # seconds
    waited=0
    until "$UNIT/.venv/bin/python" -c "import urllib.request; urllib.request.urlopen('http://127.0.0.1:$PORT/api/alive', timeout=3)" 2>/dev/null; do
        waited=$((waited + 2))
        [ "$waited" -lt "$1" ] || return 1
        sleep 2
    done
}

finish() {
    step "the unit starts"
    alive "$START_S" || fail "the unit does not answer at http://127.0.0.1:$PORT; \`obu doctor\` and \`journalctl -u 'obu@*' -n 50\` say why"
    host=$(hostname).local
    grep -q '^OBU_HTTP_HOST=127' "$CONFIG/obu.env" && host=127.0.0.1
    if [ -n "$ssid" ]; then
        echo
        echo "Join the Wi-Fi network with a phone's camera:"
        "$UNIT/.venv/bin/python" -m cli.qr --wifi "$ACCESS_POINT"
        host=10.42.7.1
    fi
    [ -z "${OBU_NO_LINK:-}" ] || return 0
    echo
    echo "Log in, once, within a day, with a phone's camera or by the link:"
    "$COMMAND" token show-link --qr --minutes 1440 --address "http://$host:$PORT"
    echo
    echo "Installed. \`obu doctor\` checks the unit, \`sudo obu token show-link --qr\` makes another login,"
    echo "\`sudo obu-install upgrade\` installs the newest version, \`sudo obu-install remove\` removes it."
}

install_unit() {
    number=0
    install_packages
    fetch_unit
    build
    configure
    start_services
    announce
    finish
}

# The former version comes back where the new one cannot be installed, or its unit does not answer.
upgrade() {
    [ -d "$UNIT/.git" ] || fail "there is no unit in $UNIT; install it first"
    former=$(git -C "$UNIT" rev-parse HEAD)
    saved=$(mktemp -d)
    cp -a "$CONFIG/vehicle.toml" "$saved/"
    install -d -m 700 "$BACKUPS"
    backup="$BACKUPS/before-upgrade-$(date -u +%Y%m%dT%H%M%SZ).zip"
    quietly "$COMMAND" backup -o "$backup"
    echo "settings and keys are kept in $backup"
    if OBU_NO_LINK=1 sh "$UNIT/deploy/install.sh" install --from "$from" ${version:+--version "$version"}; then
        rm -r "$saved"
        echo "the new version runs; logins are as before"
        return 0
    fi
    echo "the new version does not run: going back to ${former%"${former#????????}"}"
    quietly git -C "$UNIT" checkout --quiet --force --detach "$former"
    cp -a "$saved/vehicle.toml" "$CONFIG/vehicle.toml"
    rm -r "$saved"
    number=2
    build
    start_services
    alive "$START_S" && fail "the former version runs again; what kept the new one out is in $LOG"
    fail "the former version does not start either; \`obu doctor\` and $LOG say why"
}

remove() {
    systemctl disable --quiet --now obu.target rsu.target >>"$LOG" 2>&1 || true
    for unit in $(systemctl list-units --all --plain --no-legend 'obu@*' obu-broker.service 2>/dev/null | awk '{ print $1 }'); do
        systemctl stop "$unit" >>"$LOG" 2>&1 || true
    done
    for link in /etc/systemd/system/*.wants/obu@*.service; do
        [ ! -L "$link" ] || rm "$link"
    done
    rm -rf /etc/systemd/system/obu@* /etc/systemd/system/obu-broker.service /etc/systemd/system/obu.target \
        /etc/systemd/system/rsu.target /etc/systemd/system/obu.target.wants /etc/systemd/system/rsu.target.wants \
        /etc/udev/rules.d/99-obu.rules "$NAME" "$COMMAND" "$COMMAND-install" "$UNIT"
    systemctl daemon-reload
    if [ -e "$ACCESS_POINT" ]; then
        nmcli connection delete obu-access-point >>"$LOG" 2>&1 || true
        rm -f "$ACCESS_POINT"
    fi
    if [ -z "$purge" ]; then
        echo "removed; settings are still in $CONFIG, drives in $STATE, keys in $SECRETS, backups in $BACKUPS"
        echo "(\`remove --purge\` deletes them too). Debian's packages stay."
        return 0
    fi
    rm -rf "$CONFIG" "$STATE" "$SECRETS" /var/lib/obu-broker "$BACKUPS"
    for user in $(getent passwd | sed -n 's/^\(obu\(-[a-z0-9-]*\)\{0,1\}\):.*/\1/p'); do
        userdel "$user" >>"$LOG" 2>&1 || true
    done
    for group in obu obu-evidence; do
        groupdel "$group" >>"$LOG" 2>&1 || true
    done
    echo "removed, with settings, drives, keys, backups and users. Debian's packages stay."
}

main() {
    action=install from="" version="" simulated="" local_only="" ssid="" interface=wlan0 purge=""
    while [ $# -gt 0 ]; do
        case $1 in
        install | upgrade | remove) action=$1 ;;
        -h | --help) help && exit 0 ;;
        --simulated) simulated=1 ;;
        --local) local_only=1 ;;
        --purge) purge=1 ;;
        --from | --version | --access-point | --interface)
            [ $# -gt 1 ] || fail "$1 wants a value; --help shows examples" 2
            case $1 in
            --from) from=$2 ;;
            --version) version=$2 ;;
            --access-point) ssid=$2 ;;
            --interface) interface=$2 ;;
            esac
            shift
            ;;
        *) fail "$1 is not known; --help lists what is" 2 ;;
        esac
        shift
    done
    case $version in -*) fail "$version is no name of a version" 2 ;; esac
    case $from in -*) fail "$from is no address" 2 ;; esac
    [ "${#ssid}" -le 32 ] || fail "the name of a Wi-Fi network has at most 32 characters" 2
    [ -z "$purge" ] || [ "$action" = remove ] || fail "--purge belongs to remove" 2
    check_machine
    (umask 077 && : >>"$LOG")
    if [ -z "$from" ] && [ "$action" != remove ]; then
        here=$(cd "$(dirname "$0")/.." 2>/dev/null && pwd) || here=
        [ -e "$here/deploy/install.sh" ] || fail "say where the unit is fetched from: --from <address of the repository>" 2
        from=$here
        # An upgrade fetches from where the unit came from.
        if [ "$here" = "$UNIT" ] && [ "$action" = upgrade ]; then
            from=$(git -C "$UNIT" remote get-url origin) || fail "say where the new version is: --from <address>" 2
        fi
    fi
    case $action in
    install) install_unit ;;
    *) "$action" ;;
    esac
}

main "$@" && exit
