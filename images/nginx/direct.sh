#!/bin/sh
# Starts the proxy for robots' published ports. Without a list of sources, or with one that nginx does not understand, it
# does not start, and then nothing is published.
set -eu
. /usr/lib/robotether/networks.sh
. /usr/lib/robotether/open-files.sh

# Unhealthy, and not started again and again: nothing changes until somebody changes the setting.
fail() {
  echo "cannot publish robots' ports: $*" >&2
  exec sleep infinity
}

is_port() {
  case "$1" in
    '' | *[!0-9]* | ??????*) return 1 ;;
    *) [ "$1" -ge 1024 ] && [ "$1" -le 65535 ] ;;
  esac
}

write_listen() {
  is_port "$DIRECT_PORT_FIRST" || fail "DIRECT_PORT_FIRST is '$DIRECT_PORT_FIRST'; allowed is 1024 to 65535"
  is_port "$DIRECT_PORT_LAST" || fail "DIRECT_PORT_LAST is '$DIRECT_PORT_LAST'; allowed is 1024 to 65535"
  [ "$DIRECT_PORT_FIRST" -le "$DIRECT_PORT_LAST" ] || fail "DIRECT_PORT_LAST is less than DIRECT_PORT_FIRST"
  echo "listen $DIRECT_PORT_FIRST-$DIRECT_PORT_LAST so_keepalive=10:5:3;" > /run/nginx/direct-listen.conf
}

write_sources() {
  [ -n "${DIRECT_SOURCES:-}" ] || fail "DIRECT_SOURCES is ''; allowed are networks such as 192.0.2.0/24, with commas between"
  list_networks DIRECT_SOURCES "$DIRECT_SOURCES" > /run/nginx/networks
  { sed 's/.*/allow &;/' /run/nginx/networks; echo 'deny all;'; } > /run/nginx/direct-sources.conf
}

main() {
  write_listen
  write_sources
  raise_open_files
  nginx -t -q -c /etc/nginx/direct.conf ||
    fail "DIRECT_SOURCES is '$DIRECT_SOURCES'; allowed are networks such as 192.0.2.0/24, with commas between"
  echo "direct: ports $DIRECT_PORT_FIRST to $DIRECT_PORT_LAST are open to $DIRECT_SOURCES"
  exec nginx -c /etc/nginx/direct.conf
}

main
