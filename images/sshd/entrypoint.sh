#!/bin/sh
# Starts sshd in the foreground. At the first start it makes the host key, which a volume keeps: robots pin it.
set -eu

readonly KEY=/etc/ssh/keys/ssh_host_ed25519_key
readonly PUBLIC=/etc/ssh/public

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
      echo "cannot start sshd: the secret $name is missing or empty; run make up, which makes it" >&2
      exit 1
    fi
  done
}

main() {
  ensure_secrets
  mkdir -p /run/sshd
  ensure_host_key
  ensure_public_copy
  /usr/sbin/sshd -t
  echo "sshd: host key $(ssh-keygen -lf "$KEY.pub")"
  exec /usr/sbin/sshd -D -e
}

main
