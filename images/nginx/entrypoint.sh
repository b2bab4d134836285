#!/bin/sh
# Starts nginx in the foreground. At the first start it makes a self-signed certificate, which a volume keeps:
# robots pin it, so it changes only when somebody deletes or replaces it.
set -eu

readonly TLS=/etc/nginx/tls
readonly HOST="${PUBLIC_HOST:-localhost}"

subject_alternative_names() {
  case "$HOST" in
    *:* | *[!0-9.]*) : ;;
    *) printf 'IP:%s,' "$HOST" ;;
  esac
  case "$HOST" in
    *:*) printf 'IP:%s,' "$HOST" ;;
    *[!0-9.]*) printf 'DNS:%s,' "$HOST" ;;
  esac
  printf 'DNS:localhost,IP:127.0.0.1'
}

ensure_certificate() {
  if [ -s "$TLS/cert.pem" ] && [ -s "$TLS/key.pem" ]; then return; fi
  openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 3650 \
    -subj "/CN=$HOST" -addext "subjectAltName=$(subject_alternative_names)" \
    -addext extendedKeyUsage=serverAuth \
    -keyout "$TLS/key.pem.new" -out "$TLS/cert.pem.new" 2>/dev/null
  chmod 600 "$TLS/key.pem.new"
  # The key first: a pair is complete once the certificate is there.
  mv "$TLS/key.pem.new" "$TLS/key.pem"
  mv "$TLS/cert.pem.new" "$TLS/cert.pem"
}

main() {
  case "$HOST" in
    *[!A-Za-z0-9.:-]*)
      echo "cannot start nginx: PUBLIC_HOST is '$HOST'; allowed is a host name or an address" >&2
      exit 1
      ;;
  esac
  ensure_certificate
  nginx -t
  echo "nginx: certificate $(openssl x509 -in "$TLS/cert.pem" -noout -fingerprint -sha256)"
  # A socket of a former nginx that was killed would keep this one from listening.
  rm -f /run/nginx/tls.sock /run/nginx/ssh.sock
  exec nginx
}

main
