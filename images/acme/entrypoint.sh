#!/bin/sh
# Keeps a certificate for DOMAIN: gets one, and another when the authority asks for it or too little of its life is left.
# A failure changes nothing of what serves; it is told in the log, and tried again after a pause that grows, as
# authorities count failures.
set -eu

readonly STATE=/var/lib/acme
readonly CHALLENGES=/var/lib/acme-challenge
readonly OUT=/etc/nginx/acme
readonly ACCOUNT=$STATE/account
# Touched every BEAT_S seconds, also while lego works or this sleeps.
readonly ALIVE=/tmp/alive
readonly BEAT_S=5
# Time limit for one attempt of lego, which has a shorter one for each of its steps.
readonly ATTEMPT_S=600
readonly SHORTEST_LOOK_S=5
readonly LONGEST_LOOK_S=21600
readonly FIRST_PAUSE_S=20
readonly LONGEST_PAUSE_S=21600

# Unhealthy, and not started again and again: nothing changes until somebody changes the setting.
fail() {
  echo "cannot get a certificate: $*" >&2
  exec sleep infinity
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

# Keeps saying that this is alive while a command runs; ends with its status.
beating() { # command
  "$@" &
  while kill -0 "$!" 2>/dev/null; do
    touch "$ALIVE"
    sleep "$BEAT_S"
  done
  wait "$!"
}

ask() { # run or renew, with its options
  beating timeout --signal=KILL "$ATTEMPT_S" lego --accept-tos --email "$ACME_EMAIL" --domains "$DOMAIN" --server "$ACME_SERVER" --path "$STATE" \
    --http --http.webroot "$CHALLENGES" "$@"
}

# An account of another authority or address cannot renew what this one got. A state from before has no such note.
is_renewable() {
  [ -s "$STATE/certificates/$DOMAIN.key" ] &&
    { ! [ -s "$ACCOUNT" ] || [ "$(cat "$ACCOUNT")" = "$ACME_SERVER $ACME_EMAIL" ]; }
}

# lego renews when the authority says so (ARI, RFC 9773), or says nothing and a third of the life is left, of a life of 10
# days and less a half.
get() {
  if is_renewable; then
    ask renew --dynamic --no-random-sleep
  else
    ask run
  fi && echo "$ACME_SERVER $ACME_EMAIL" > "$ACCOUNT"
}

is_handed_over() { cmp -s "$STATE/certificates/$DOMAIN.crt" "$OUT/current/cert.pem"; }

# nginx sees the old pair or the new one, and never half of each. In main's condition `set -e` is off: each step is asked.
hand_over() {
  name=pair-$(date +%s)
  if ! make_pair "$OUT/$name" || ! ln -sfn "$name" "$OUT/current.new" || ! mv -T "$OUT/current.new" "$OUT/current"; then
    rm -rf "${OUT:?}/$name"
    return 1
  fi
  find "$OUT" -mindepth 1 -maxdepth 1 -type d -name 'pair-*' ! -name "$name" -exec rm -r {} +
  echo "acme: $DOMAIN has a certificate until $(openssl x509 -in "$OUT/current/cert.pem" -noout -enddate | cut -d= -f2)"
}

make_pair() { # folder
  mkdir -p "$1" &&
    cp "$STATE/certificates/$DOMAIN.crt" "$1/cert.pem" &&
    cp "$STATE/certificates/$DOMAIN.key" "$1/key.pem" &&
    life_s "$1/cert.pem" > "$1/life_s"
}

# Often enough for a window of a few hours in a life of days, and no more often than authorities want to be asked.
until_next_look_s() {
  pause_s=$(($(cat "$OUT/current/life_s") / 50))
  if [ "$pause_s" -lt "$SHORTEST_LOOK_S" ]; then pause_s=$SHORTEST_LOOK_S; fi
  if [ "$pause_s" -gt "$LONGEST_LOOK_S" ]; then pause_s=$LONGEST_LOOK_S; fi
  echo "$pause_s"
}

main() {
  umask 077
  check_settings
  if [ -s /etc/robotether/acme-ca.pem ]; then export LEGO_CA_CERTIFICATES=/etc/robotether/acme-ca.pem; fi
  pause_s=$FIRST_PAUSE_S
  while :; do
    if get && { is_handed_over || hand_over; }; then
      pause_s=$FIRST_PAUSE_S
      beating sleep "$(until_next_look_s)"
    else
      echo "acme: no certificate for $DOMAIN, or none newer; next try in $pause_s s. $DOMAIN must lead to port 80 of this server" >&2
      beating sleep "$pause_s"
      pause_s=$((pause_s * 4))
      if [ "$pause_s" -gt "$LONGEST_PAUSE_S" ]; then pause_s=$LONGEST_PAUSE_S; fi
    fi
  done
}

main
