#!/bin/sh
# Starts nginx in the foreground, and beside it the watch for newer certificates. At the first start it makes a
# self-signed certificate, which a volume keeps.
set -eu
. /usr/lib/robotether/certificates.sh
. /usr/lib/robotether/networks.sh
. /usr/lib/robotether/open-files.sh

readonly HOST="${PUBLIC_HOST:-localhost}"
readonly PORT="${PUBLIC_PORT:-443}"
# The cells to which requests are forwarded, one IP:PORT a line.
readonly CELLS=/run/nginx/peers/cells
readonly ASK_FOR_CELLS_EVERY_S=2

fail() {
  echo "cannot start nginx: $*" >&2
  exit 1
}

# Other cells of the site, if it has a certificate for them. The relay makes the same hash of the key
# (relay/cells/keys.py).
serve_peers() {
  rm -rf /run/nginx/peers
  mkdir /run/nginx/peers
  if ! [ -s "$OWN/peer_cert.pem" ] || ! [ -s "$OWN/peer_key.pem" ]; then return; fi
  (umask 077 && sha256sum "$OWN/peer_key.pem" | sed 's/^\([0-9a-f]*\) .*/proxy_set_header Robotether-Peer \1;/' > /run/nginx/peers/proof)
  ln -s /etc/nginx/peer-server.conf /run/nginx/peers/server.conf
  ln -s /etc/nginx/peer-forward.conf /run/nginx/peers/forward.conf
  : > "$CELLS"
  write_cells
}

# For each cell an upstream, as only that keeps connections; what asks for an upgrade ends its own, and gets none of them.
# A cell that is not in the list gets a connection for each request. The other side keeps one that is idle for 30 s.
# shellcheck disable=SC2016 # nginx's variables
write_cells() {
  {
    awk '{ print "upstream cell" NR " { server " $0 "; keepalive 16; keepalive_timeout 20s; }" }' "$CELLS"
    echo 'map $upgrade$upstream_http_x_robotether_cell $kept_cell {'
    echo '    default $upstream_http_x_robotether_cell;'
    awk '{ print "    \"" $0 "\" cell" NR ";" }' "$CELLS"
    echo '}'
  } > /run/nginx/peers/server-cells.conf
}

# One that is gone stays in the list: it may come back, and each reload leaves old workers behind with what is open.
learn_cells() { # fails without a new one
  # shellcheck disable=SC2016 # nginx's variable
  relay=$(sed -n 's/^set \$relay_inside \(.*\);/\1/p' /etc/nginx/parts.conf)
  curl --silent --fail --noproxy '*' --max-time 2 "http://$relay/cells" |
    grep -E '^([0-9.]+|\[[0-9a-f:]+\]):[0-9]+$' | sort -u - "$CELLS" > "$CELLS.new"
  if cmp -s "$CELLS.new" "$CELLS"; then return 1; fi
  mv "$CELLS.new" "$CELLS"
}

watch_cells() {
  while sleep "$ASK_FOR_CELLS_EVERY_S"; do
    if learn_cells; then
      write_cells
      nginx -t -q && nginx -s reload
    fi
  done
}

# For the redirect from port 80.
write_https_port() {
  case "$PORT" in
    *[!0-9]*) fail "PUBLIC_PORT is '$PORT'; allowed is 1 to 65535" ;;
    443) suffix='' ;;
    *) suffix=":$PORT" ;;
  esac
  echo "set \$https_port \"$suffix\";" > /run/nginx/https-port.conf
}

# The proxies in front whose word for who asks counts.
write_trusted_proxies() {
  list_networks TRUSTED_PROXIES "${TRUSTED_PROXIES:-}" > /run/nginx/networks
  sed 's/.*/set_real_ip_from &;/' /run/nginx/networks > /run/nginx/real-ip.conf
  sed 's/.*/& 1;/' /run/nginx/networks > /run/nginx/trusted-proxies.conf
}

write_access_log() {
  case "${LOG_FORMAT:-text}" in json) name=json ;; *) name=paths ;; esac
  echo "access_log /dev/stdout $name;" > /run/nginx/access-log.conf
}

main() {
  case "$HOST" in
    *[!A-Za-z0-9.:-]*) fail "PUBLIC_HOST is '$HOST'; allowed is a host name or an address" ;;
  esac
  write_https_port
  write_trusted_proxies
  write_access_log
  ensure_self_signed "$HOST"
  (umask 077 && mkdir -p "$KEPT")
  ln -sfn "$KEPT" "$SERVED"
  serve_peers
  serve "$(chosen)"
  report_served
  raise_open_files
  nginx -t -q
  # A socket of a former nginx that was killed would keep this one from listening.
  rm -f /run/nginx/http.sock /run/nginx/tls.sock
  watch_certificates &
  if [ -e "$CELLS" ]; then watch_cells & fi
  exec nginx
}

main
