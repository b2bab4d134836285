#!/bin/sh
# Starts the key look-ups, the two watches, nginx for log-ins through 443, and sshd in the foreground. At the first
# start it makes the host key, which a volume keeps: robots pin it. A secret of that name goes before what was made: all
# cells of a site have one.
set -eu

readonly KEY=/etc/ssh/keys/ssh_host_ed25519_key
readonly OWN_KEY=/run/secrets/ssh_host_ed25519_key
readonly PUBLIC=/etc/ssh/public
readonly LOG=/run/sshd/log
readonly PROXY_PROTOCOL=/etc/nginx/proxy-protocol.conf

ensure_host_key() {
  if [ -s "$OWN_KEY" ]; then
    (umask 077 && cat "$OWN_KEY" > "$KEY.new")
    ssh-keygen -y -f "$KEY.new" > "$KEY.pub" || fail "the secret ssh_host_ed25519_key is not a private key without a password"
    mv "$KEY.new" "$KEY"
    return
  fi
  if ! [ -s "$KEY" ]; then ssh-keygen -q -t ed25519 -N '' -C robotether -f "$KEY"; fi
  # A start that ended between the two halves left one.
  if ! [ -s "$KEY.pub" ]; then ssh-keygen -y -f "$KEY" > "$KEY.pub"; fi
}

# The web service hands the public half to robots that join; it never sees the private one.
ensure_public_copy() {
  cp "$KEY.pub" "$PUBLIC/.new"
  chmod 644 "$PUBLIC/.new"
  mv "$PUBLIC/.new" "$PUBLIC/$(basename "$KEY").pub"
}

fail() {
  echo "cannot start sshd: $*" >&2
  exit 1
}

ensure_secrets() {
  for name in mysql_keylookup_password session_key; do
    [ -s "/run/secrets/$name" ] ||
      fail "the secret $name is missing or empty; compose's service secrets makes it: docker compose up -d"
  done
}

# How the key look-ups reach the database. sshd gives them no environment, hence a file: what the image has, and where
# the database is.
ensure_database_options() {
  case "${DB_HOST:-mysql}" in *[!A-Za-z0-9.:-]*) fail "DB_HOST is '$DB_HOST'; allowed is a host name or an address" ;; esac
  case "${DB_PORT:-3306}" in *[!0-9]*) fail "DB_PORT is '$DB_PORT'; allowed is a port number" ;; esac
  {
    cat /etc/robotether/keylookup.cnf
    printf 'host = %s\nport = %s\n' "${DB_HOST:-mysql}" "${DB_PORT:-3306}"
    # The network `data` exists on one host only. The client program and its library have each a word of their own for
    # TLS.
    if [ -n "${DB_CA_FILE:-}" ]; then
      printf 'ssl-ca = %s\nssl-verify-server-cert = 1\n[key-lookups]\nssl-enforce = 1\n' "$DB_CA_FILE"
    else
      printf 'skip-ssl\n[key-lookups]\nssl-enforce = 0\n'
    fi
  } > /run/robotether/keylookup.cnf
  chmod 644 /run/robotether/keylookup.cnf
}

as_jump_watch() { setpriv --reuid jump --regid jumpwatch --clear-groups "$@"; }
as_tunnel_watch() { setpriv --reuid tunnel --regid tunnel --clear-groups "$@"; }
as_keylookup() { setpriv --reuid keylookup --regid keylookup --clear-groups "$@"; }
# Number of files that nginx's connections need (proxy-protocol.conf); Docker 29 lets a container begin with 1024.
readonly OPEN_FILES=32768
raise_open_files() {
  # Debian's sh, dash, has both limits.
  # shellcheck disable=SC3045
  highest=$(ulimit -H -n)
  if [ "$highest" = unlimited ] || [ "$highest" -ge "$OPEN_FILES" ]; then highest=$OPEN_FILES; fi
  # shellcheck disable=SC3045
  ulimit -S -n "$highest"
}
as_nginx() { setpriv --reuid www-data --regid www-data --clear-groups "$@"; }

# Root has no right here to give a folder away, so the accounts make their own. The register of connections is written
# by jump-keys and cleared by jump-watch; nobody else may as much as look into it.
ensure_run_folders() {
  install -d -m 1777 /run/robotether
  as_keylookup install -d -m 755 /run/robotether/key-lookups
  setpriv --reuid keylookup --regid jumpwatch --clear-groups install -d -m 770 /run/robotether/jump
  as_jump_watch install -d -m 755 /run/robotether/jump-watch
  as_tunnel_watch install -d -m 755 /run/robotether/tunnel-watch
  as_nginx install -d -m 755 /run/robotether/proxy-protocol
  chmod 755 /run/robotether
}

# The loops run with the programs' own rights. Should a loop end too, then the container is unhealthy, and without
# jump-watch nobody new gets in as jump.
start_beside_sshd() {
  # shellcheck disable=SC2016 # $@, $1 and $? are the inner shell's
  readonly keep_running='while :; do "$@"; echo "$1 ended with $?; starting it again" >&2; sleep 1; done'
  # A name server that does not answer must not hold up who is let in by the cache.
  as_keylookup env RES_OPTIONS='timeout:1 attempts:1' sh -c "$keep_running" loop /usr/lib/robotether/key-lookups &
  as_jump_watch sh -c "$keep_running" loop /usr/lib/robotether/jump-watch &
  as_tunnel_watch sh -c "$keep_running" loop /usr/lib/robotether/tunnel-watch &
  # A worker outlives a master that was killed, and keeps its port, which the kernel closes a moment after the signal.
  # shellcheck disable=SC2016 # $? and $1 are the inner shell's
  readonly keep_nginx='while :; do
    while pkill -KILL -x nginx; do sleep 0.1; done
    nginx -c "$1"
    echo "nginx ended with $?; starting it again" >&2
    sleep 1
  done'
  (raise_open_files && as_nginx sh -c "$keep_nginx" loop "$PROXY_PROTOCOL") 2>&1 &
  # Fails while the database is away, and leaves the cache as it is then.
  as_keylookup sh -c 'while :; do /usr/lib/robotether/authorized-keys cache; sleep 60; done' &
}

# Passes sshd's log on, except what is no event.
start_log() {
  rm -f "$LOG"
  mkfifo "$LOG"
  (while :; do sed -u -E -f /usr/lib/robotether/quiet.sed < "$LOG" >&2; done) &
}

main() {
  ensure_secrets
  mkdir -p /run/sshd
  ensure_host_key
  ensure_public_copy
  /usr/sbin/sshd -t
  ensure_run_folders
  ensure_database_options
  as_nginx nginx -t -q -c "$PROXY_PROTOCOL"
  start_beside_sshd
  echo "sshd: host key $(ssh-keygen -lf "$KEY.pub")"
  if [ "${LOG_LEVEL:-info}" = debug ]; then exec /usr/sbin/sshd -D -e; fi
  start_log
  # Open for both ways: sshd goes on while nobody reads.
  exec /usr/sbin/sshd -D -e 2<> "$LOG"
}

main
