#!/bin/sh
# Starts the two watches, nginx for log-ins through 443, and sshd in the foreground. At the first start it makes the host key, which a volume keeps: robots
# pin it.
set -eu

readonly KEY=/etc/ssh/keys/ssh_host_ed25519_key
readonly PUBLIC=/etc/ssh/public
readonly PROXY_PROTOCOL=/etc/nginx/proxy-protocol.conf

ensure_host_key() {
  if [ -s "$KEY" ]; then return; fi
  ssh-keygen -q -t ed25519 -N '' -C robotether -f "$KEY"
}

# The web service hands the public half to robots that join; it never sees the private one.
ensure_public_copy() {
  cp "$KEY.pub" "$PUBLIC/.new"
  chmod 644 "$PUBLIC/.new"
  mv "$PUBLIC/.new" "$PUBLIC/$(basename "$KEY").pub"
}

ensure_secrets() {
  for name in mysql_keylookup_password session_key; do
    if [ ! -s "/run/secrets/$name" ]; then
      echo "cannot start sshd: the secret $name is missing or empty; compose's service secrets makes it: docker compose up -d" >&2
      exit 1
    fi
  done
}

as_jump_watch() { setpriv --reuid jump --regid jumpwatch --clear-groups "$@"; }
as_tunnel_watch() { setpriv --reuid tunnel --regid tunnel --clear-groups "$@"; }
as_nginx() { setpriv --reuid www-data --regid www-data --clear-groups "$@"; }

# Root has no right here to give a folder away, so the accounts make their own. The register of connections is written
# by jump-keys and cleared by jump-watch; nobody else may as much as look into it.
ensure_run_folders() {
  install -d -m 1777 /run/robotether
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
  as_jump_watch sh -c "$keep_running" loop /usr/lib/robotether/jump-watch &
  as_tunnel_watch sh -c "$keep_running" loop /usr/lib/robotether/tunnel-watch &
  as_nginx sh -c "$keep_running" loop nginx -c "$PROXY_PROTOCOL" &
}

main() {
  ensure_secrets
  mkdir -p /run/sshd
  ensure_host_key
  ensure_public_copy
  /usr/sbin/sshd -t
  ensure_run_folders
  as_nginx nginx -t -q -c "$PROXY_PROTOCOL"
  start_beside_sshd
  echo "sshd: host key $(ssh-keygen -lf "$KEY.pub")"
  exec /usr/sbin/sshd -D -e
}

main
