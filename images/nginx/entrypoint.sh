#!/bin/sh
# Starts nginx in the foreground, and beside it the watch for newer certificates. At the first start it makes a
# self-signed certificate, which a volume keeps.
set -eu
. /usr/lib/robotether/certificates.sh

readonly HOST="${PUBLIC_HOST:-localhost}"

main() {
  case "$HOST" in
    *[!A-Za-z0-9.:-]*)
      echo "cannot start nginx: PUBLIC_HOST is '$HOST'; allowed is a host name or an address" >&2
      exit 1
      ;;
  esac
  ensure_self_signed "$HOST"
  serve "$(chosen)"
  nginx -t
  # A socket of a former nginx that was killed would keep this one from listening.
  rm -f /run/nginx/tls.sock
  watch_certificates &
  exec nginx
}

main
