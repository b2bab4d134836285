#!/bin/sh
# Keeps a certificate for DOMAIN: gets one, and another when a third of its life is left. A failure changes nothing of
# what serves; it is told in the log, and tried again after a pause that grows, as authorities count failures.
set -eu

readonly STATE=/var/lib/acme
readonly CHALLENGES=/var/lib/acme-challenge
readonly OUT=/etc/nginx/acme
readonly LOOK_EVERY_S=5
readonly FIRST_PAUSE_S=20
readonly LONGEST_PAUSE_S=21600

fail() {
  echo "cannot get a certificate: $*" >&2
  exit 1
}

check_settings() {
  case "${DOMAIN:-}" in
    '' | *[!a-z0-9.-]* | .* | *. | -*) fail "DOMAIN is '${DOMAIN:-}'; allowed is a host name in small letters" ;;
    *.*) : ;;
    *) fail "DOMAIN is '$DOMAIN'; a public authority signs no name without a dot" ;;
  esac
  case "${ACME_EMAIL:-}" in
    *?@?*) : ;;
    *) fail "ACME_EMAIL is '${ACME_EMAIL:-}'; the authority wants an address that it can write to" ;;
  esac
  case "${ACME_SERVER:-}" in
    https://*) : ;;
    *) fail "ACME_SERVER is '${ACME_SERVER:-}'; allowed is the https URL of a directory" ;;
  esac
}

seconds_of() { # -startdate or -enddate, certificate
  date -d "$(openssl x509 -in "$2" -noout "$1" | cut -d= -f2)" +%s
}

life_s() { # certificate
  echo "$(($(seconds_of -enddate "$1") - $(seconds_of -startdate "$1")))"
}

is_due() {
  certificate=$OUT/current/cert.pem
  ! [ -s "$certificate" ] ||
    ! openssl x509 -in "$certificate" -noout -checkend "$(($(life_s "$certificate") / 3))" >/dev/null ||
    ! openssl x509 -in "$certificate" -noout -checkhost "$DOMAIN" | grep -q 'does match'
}

ask() { # run or renew, with its options
  lego --accept-tos --email "$ACME_EMAIL" --domains "$DOMAIN" --server "$ACME_SERVER" --path "$STATE" \
    --http --http.webroot "$CHALLENGES" "$@"
}

# What lego has is renewed whatever its age: whether it is due was decided here.
get() {
  if [ -s "$STATE/certificates/$DOMAIN.key" ]; then
    ask renew --days 36500 --no-random-sleep
  else
    ask run
  fi
}

# nginx sees the old pair or the new one, and never half of each.
hand_over() {
  name=pair-$(date +%s)
  mkdir -p "$OUT/$name"
  cp "$STATE/certificates/$DOMAIN.crt" "$OUT/$name/cert.pem"
  cp "$STATE/certificates/$DOMAIN.key" "$OUT/$name/key.pem"
  life_s "$OUT/$name/cert.pem" > "$OUT/$name/life_s"
  ln -sfn "$name" "$OUT/current.new"
  mv -T "$OUT/current.new" "$OUT/current"
  find "$OUT" -mindepth 1 -maxdepth 1 -type d -name 'pair-*' ! -name "$name" -exec rm -r {} +
  echo "acme: $DOMAIN has a certificate until $(openssl x509 -in "$OUT/current/cert.pem" -noout -enddate | cut -d= -f2)"
}

main() {
  umask 077
  check_settings
  if [ -s /etc/robotether/acme-ca.pem ]; then export LEGO_CA_CERTIFICATES=/etc/robotether/acme-ca.pem; fi
  pause_s=$FIRST_PAUSE_S
  while :; do
    if ! is_due; then
      sleep "$LOOK_EVERY_S"
    elif get && hand_over; then
      pause_s=$FIRST_PAUSE_S
    else
      echo "acme: no certificate for $DOMAIN yet; next try in $pause_s s. $DOMAIN must lead to port 80 of this server" >&2
      sleep "$pause_s"
      pause_s=$((pause_s * 4))
      if [ "$pause_s" -gt "$LONGEST_PAUSE_S" ]; then pause_s=$LONGEST_PAUSE_S; fi
    fi
  done
}

main
