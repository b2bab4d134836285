#!/bin/sh
# Starts nginx in the foreground, and beside it the watch for newer certificates. At the first start it makes a
# self-signed certificate, which a volume keeps.
set -eu
. /usr/lib/robotether/certificates.sh

readonly HOST="${PUBLIC_HOST:-localhost}"

# Other cells of the site, if it has a certificate for them. The relay makes the same hash of the key
# (relay/peers/peer_keys.py).
serve_peers() {
  rm -rf /run/nginx/peers
  mkdir /run/nginx/peers
  if ! [ -s "$OWN/peer_cert.pem" ] || ! [ -s "$OWN/peer_key.pem" ]; then return; fi
  (umask 077 && sha256sum "$OWN/peer_key.pem" | sed 's/^\([0-9a-f]*\) .*/proxy_set_header Robotether-Peer \1;/' > /run/nginx/peers/proof)
  ln -s /etc/nginx/peer-server.conf /run/nginx/peers/server.conf
  ln -s /etc/nginx/peer-forward.conf /run/nginx/peers/forward.conf
}

main() {
  case "$HOST" in
    *[!A-Za-z0-9.:-]*)
      echo "cannot start nginx: PUBLIC_HOST is '$HOST'; allowed is a host name or an address" >&2
      exit 1
      ;;
  esac
  ensure_self_signed "$HOST"
  serve_peers
  serve "$(chosen)"
  nginx -t
  # A socket of a former nginx that was killed would keep this one from listening.
  rm -f /run/nginx/tls.sock
  watch_certificates &
  exec nginx
}

main
