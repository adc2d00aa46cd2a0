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
SETTINGS=$SECRETS/settings # changed on the page
ADDRESS=$SECRETS/page/status.address # where the page says it listens
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

# Whether Python is 3.11 or newer: that which is installed, else that which would be.
python_is_new() {
    if command -v python3 >/dev/null; then
        python3 -c 'import sys; sys.exit(sys.version_info < (3, 11))'
    else
        apt-cache policy python3 2>/dev/null | awk '/Candidate:/ { split($2, v, "."); exit !(v[1] == 3 && v[2] >= 11) }'
    fi
}

check_machine() {
    case " $(system_of ID) $(system_of ID_LIKE) " in
    *" debian "*) ;;
    *) fail "this is $(system_of PRETTY_NAME): Debian or Raspberry Pi OS, 12 or 13, is needed; elsewhere use containers (docs/how-to/run-in-containers.md)" ;;
    esac
    release=$(system_of VERSION_ID)
    case $(system_of ID) in
    debian | raspbian) release=${release:-99} ;; # testing has no number
    *) release=0 ;;                              # its numbers are its own: its Python decides
    esac
    [ "${release%%.*}" -ge 12 ] 2>/dev/null || { [ "$release" = 0 ] && python_is_new; } ||
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
        quietly env OBU_VEHICLE="$CONFIG/vehicle.toml" OBU_STATE="$STATE" \
            "$UNIT/.venv/bin/python" -m cli migrate "$CONFIG/vehicle.toml"
    fi
    if [ ! -e "$CONFIG/obu.env" ]; then
        install -m 644 "$UNIT/deploy/systemd/obu.env" "$CONFIG/obu.env"
        [ -n "$local_only" ] || sed -i 's/^OBU_HTTP_HOST=.*/OBU_HTTP_HOST=0.0.0.0/' "$CONFIG/obu.env"
    elif [ -n "$local_only" ]; then
        echo "    --local changes nothing here: set OBU_HTTP_HOST in $CONFIG/obu.env, and restart the unit"
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
    rm -f "$ADDRESS" # that of the process that is replaced
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
  <service><type>_http._tcp</type><port>$port</port></service>
</service-group>
TEXT
    for service in avahi-daemon chrony; do
        systemctl enable --quiet --now "$service" >>"$LOG" 2>&1 || echo "    $service does not start; see: systemctl status $service"
    done
    [ -n "$ssid" ] || return 0
    if [ -e "$ACCESS_POINT" ]; then
        echo "    the access point of $ACCESS_POINT stays as it is; remove that file for another one"
    else
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

# Units of systemd that the unit's target wants and that do not run.
not_running() {
    for target in obu rsu; do
        systemctl is-enabled --quiet "$target.target" 2>/dev/null || continue
        for wanted in $(systemctl show --property Wants --value "$target.target"); do
            systemctl is-active --quiet "$wanted" || echo "$wanted"
        done
    done
}

page_answers() {
    [ -s "$ADDRESS" ] || return 1
    "$UNIT/.venv/bin/python" -c "import sys, urllib.request as web; web.urlopen(sys.argv[1] + 'api/alive', timeout=3)" \
        "$(cat "$ADDRESS")" 2>/dev/null
}

# Whether the page of the processes just started answers and all of them run, at two looks: one may end at once.
alive() { # seconds
    waited=0 looks=0
    while [ "$looks" -lt 2 ]; do
        if page_answers && [ -z "$(not_running)" ]; then looks=$((looks + 1)); else looks=0; fi
        [ "$waited" -lt "$1" ] || return 1
        waited=$((waited + 3))
        sleep 3
    done
}

wait_for_unit() {
    step "the unit starts"
    if ! alive "$START_S"; then
        page_answers || echo "install: its page does not answer" >&2
        fail "the unit does not start; what does not run: $(not_running | tr '\n' ' ')
install: \`obu doctor\` and \`journalctl -u 'obu@*' -n 50\` say why"
    fi
    address=$(cat "$ADDRESS")
    port=${address##*:} port=${port%/}
}

finish() {
    host=${address#http://} host=${host%:*}
    if [ "$host" = 127.0.0.1 ] && ! grep -q '^OBU_HTTP_HOST=127' "$CONFIG/obu.env"; then host=$(hostname).local; fi
    if [ -n "$ssid" ]; then
        echo
        echo "Join the Wi-Fi network with a phone's camera:"
        "$UNIT/.venv/bin/python" -m cli.qr --wifi "$ACCESS_POINT"
        host=10.42.7.1
    fi
    [ -z "${OBU_NO_LINK:-}" ] || return 0
    echo
    echo "Log in, once, within a day, with a phone's camera or by the link:"
    "$COMMAND" token show-link --qr --minutes 1440 --address "http://$host:$port"
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
    wait_for_unit
    announce
    finish
}

# The former version comes back where the new one cannot be installed, or a process of it does not run.
upgrade() {
    [ -d "$UNIT/.git" ] || fail "there is no unit in $UNIT; install it first"
    former=$(git -C "$UNIT" rev-parse HEAD)
    saved=$(mktemp -d)
    cp -a "$CONFIG/vehicle.toml" "$saved/"
    [ ! -d "$SETTINGS" ] || cp -a "$SETTINGS" "$saved/settings"
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
    if [ -d "$saved/settings" ]; then
        rm -rf "$SETTINGS"
        cp -a "$saved/settings" "$SETTINGS"
    fi
    rm -r "$saved"
    number=2
    build
    start_services
    alive "$START_S" && fail "the former version runs again; what kept the new one out is in $LOG"
    fail "the former version does not start either; \`obu doctor\` and $LOG say why"
}

# Those that deploy/systemd/install.sh has made: their home is the state folder.
users_of_unit() {
    getent passwd | awk -F: -v home="$STATE" '$1 ~ /^obu(-|$)/ && $6 == home { print $1 }'
}

remove() {
    for unit in obu-switched.path obu.target rsu.target; do # one that an older installation lacks fails alone
        systemctl disable --quiet --now "$unit" >>"$LOG" 2>&1 || true
    done
    for unit in $(systemctl list-units --all --plain --no-legend 'obu@*' obu-broker.service 2>/dev/null | awk '{ print $1 }'); do
        systemctl stop "$unit" >>"$LOG" 2>&1 || true
    done
    for link in /etc/systemd/system/*.wants/obu@*.service; do
        [ ! -L "$link" ] || rm "$link"
    done
    rm -rf /etc/systemd/system/obu@* /etc/systemd/system/obu-broker.service /etc/systemd/system/obu-switched.* \
        /etc/systemd/system/obu.target \
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
    for user in $(users_of_unit); do
        userdel "$user" >>"$LOG" 2>&1 || true
    done
    for group in obu obu-evidence; do
        groupdel "$group" >>"$LOG" 2>&1 || true
    done
    rm -f "$LOG"
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
    [ -z "$simulated$local_only$ssid" ] || [ "$action" = install ] ||
        fail "--simulated, --local and --access-point belong to install" 2
    [ ! -d "$from" ] || from=$(cd "$from" && pwd)
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

{ main "$@"; exit; } # in braces: a line that arrives in part runs nothing
