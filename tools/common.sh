# What the scripts in this folder share; they source it.
# shellcheck shell=bash
# Each line that a script prints begins with its name.

readonly PROGRAM=${0##*/}
SCRIPT=$(realpath --canonicalize-missing -- "$0")
readonly SCRIPT

# What a script does stands at its head.
if [ "${1:-}" = --help ]; then
  sed -n '1d; /^# shellcheck/d; s/^# //p; t; q' "$SCRIPT"
  exit
fi

say() { printf '%s: %s\n' "$PROGRAM" "$*"; }
fail() { printf '%s: %s\n' "$PROGRAM" "$*" >&2; exit 1; }

as_root() {
  if [ "$(id -u)" = 0 ]; then "$@"; else sudo "$@"; fi
}

need_root() { # what for
  if [ "$(id -u)" = 0 ]; then return; fi
  if command -v sudo >/dev/null 2>&1 && sudo -v; then return; fi
  fail "cannot $1 as user $(id -un): neither root nor sudo. As root, run in this folder: tools/$PROGRAM"
}

# As root, and one after the other: apt waits for no other apt by itself, and make runs several of these scripts at once.
# What apt starts and leaves running does not keep the lock.
apt_get() {
  # A machine that only needs a program must not get a listening daemon, too. A new one installs updates in its first minutes.
  as_root flock --close /var/lib/apt env DEBIAN_FRONTEND=noninteractive RUNLEVEL=1 apt-get -o DPkg::Lock::Timeout=600 "$@"
}

# apt's lists, which a fresh machine does not have; fetched once a script.
apt_update() {
  if [ -n "${apt_updated:-}" ]; then return; fi
  need_root "fetch apt's lists"
  local tries
  for tries in 1 2 3 4; do
    if apt_get update -qq; then
      apt_updated=1
      return
    fi
    # For the lock of its lists apt never waits; a server that is away is no error to it.
    if [ "$tries" -lt 4 ]; then sleep 15; fi
  done
  fail "cannot fetch apt's lists: see above"
}

# Distribution packages, quietly.
apt_install() {
  command -v apt-get >/dev/null 2>&1 || fail "cannot install $*: this is no Debian or Ubuntu; install them and run this again"
  need_root "install $*"
  apt_update
  apt_get install -y -qq --no-install-recommends "$@" >/dev/null
}

need_database_here() { # what cannot be done
  local services
  services=$(tools/compose config --services)
  [[ $services =~ (^|$'\n')mysql($|$'\n') ]] ||
    fail "cannot $1: the database of this site is on another machine; run this there"
}

# For tools/backup and tools/restore: programs beside the database, and in the volumes that a backup holds.
in_database() { # one of MariaDB's programs, and its arguments
  tools/compose exec -T mysql "$1" --defaults-file=/etc/mysql/mariadb.cnf "${@:2}"
}

in_volumes() { # command, which sees the volumes in /backup and the record in /record
  tools/compose --progress quiet run --rm --no-deps --no-TTY --quiet-pull backup "$@"
}

# A user whom ensure_docker has just put into the group docker does not have it in this login: use it for this script.
with_docker_group() { # the script's own arguments
  if [ -w /var/run/docker.sock ] || [ -n "${ROBOTETHER_IN_GROUP:-}" ]; then return; fi
  if [[ " $(id -nG "$(id -un)") " != *' docker '* ]]; then return; fi
  local quoted
  quoted=$(printf '%q ' "$SCRIPT" "$@")
  ROBOTETHER_IN_GROUP=1 exec sg docker -c "$quoted"
}

# The CA bundle that pip and npm need behind an inspecting proxy; empty when none is set.
ca_bundle() {
  if [ -n "${SSL_CERT_FILE:-}" ] && [ -s "$SSL_CERT_FILE" ]; then printf '%s\n' "$SSL_CERT_FILE"; fi
}
