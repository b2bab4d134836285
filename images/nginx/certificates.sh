# Which certificate serves; sourced by entrypoint.sh. nginx reads one pair in /run/nginx/tls, which is put there from the
# first of these that can serve: the admin's own (a folder that compose's service certificate fills), the one from the ACME
# authority (the service acme), the self-signed one. Each is tried before it serves (try-certificate). One that fails, such
# as one of which only half has been copied, changes nothing: what served before stays in force, also after a restart.
# shellcheck shell=sh

readonly SELF_SIGNED=/etc/nginx/tls
readonly OWN=/etc/nginx/own
readonly ACME=/etc/nginx/acme/current
readonly SERVED=/run/nginx/tls
# Where SERVED leads, in a volume.
readonly KEPT=$SELF_SIGNED/served
readonly LOOK_EVERY_S=2
# A refused pair is tried again after this many minutes: the clock may have been wrong.
readonly RETRY_MIN=1

subject_alternative_names() { # host
  case "$1" in
    *:* | *[!0-9.]*) : ;;
    *) printf 'IP:%s,' "$1" ;;
  esac
  case "$1" in
    *:*) printf 'IP:%s,' "$1" ;;
    *[!0-9.]*) printf 'DNS:%s,' "$1" ;;
  esac
  printf 'DNS:localhost,IP:127.0.0.1'
}

# For this server and no authority: who trusts it trusts nothing that its key signs. Robots pin it, so it changes only when
# somebody deletes it; one from before, which is an authority, stays for them.
ensure_self_signed() { # host
  if [ -s "$SELF_SIGNED/cert.pem" ] && [ -s "$SELF_SIGNED/key.pem" ]; then return; fi
  openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 3650 \
    -subj "/CN=$(printf %.64s "$1")" -addext "subjectAltName=$(subject_alternative_names "$1")" \
    -addext basicConstraints=critical,CA:FALSE -addext keyUsage=critical,digitalSignature \
    -addext extendedKeyUsage=serverAuth \
    -keyout "$SELF_SIGNED/key.pem.new" -out "$SELF_SIGNED/cert.pem.new" 2>/dev/null
  chmod 600 "$SELF_SIGNED/key.pem.new"
  # The key first: a pair is complete once the certificate is there.
  mv "$SELF_SIGNED/key.pem.new" "$SELF_SIGNED/key.pem"
  mv "$SELF_SIGNED/cert.pem.new" "$SELF_SIGNED/cert.pem"
}

serves_still() { # a pair that could serve when it began, and has not ended
  [ -s "$SERVED/cert.pem" ] && [ -s "$SERVED/key.pem" ] && openssl x509 -in "$SERVED/cert.pem" -noout -checkend 0 >/dev/null 2>&1
}

pair_hash() { cat "$1/cert.pem" "$1/key.pem" | sha256sum; }

# Tries a pair once, and says once why it cannot serve.
can_serve() { # folder
  [ -s "$1/cert.pem" ] && [ -s "$1/key.pem" ] || return 1
  if is_served "$1"; then
    serves_still
    return
  fi
  refused=/run/nginx/refused$(echo "$1" | tr / -)
  hash=$(pair_hash "$1")
  before=$(cat "$refused" 2>/dev/null || true)
  if [ "$hash" = "$before" ] && [ -z "$(find "$refused" -mmin "+$RETRY_MIN")" ]; then return 1; fi
  if reason=$(/usr/lib/robotether/try-certificate "$1/cert.pem" "$1/key.pem" "${PUBLIC_HOST:-}"); then
    if [ -n "$reason" ]; then echo "nginx: the certificate in $1 serves, but $reason." >&2; fi
    return
  fi
  echo "$hash" > "$refused"
  if [ "$hash" != "$before" ]; then
    echo "nginx: cannot use the certificate in $1: $reason. What served before stays in force." >&2
  fi
  return 1
}

# While a better pair is being replaced, what serves goes on.
chosen() { # prints the folder of the pair that is to serve
  for folder in "$OWN" "$ACME"; do
    if can_serve "$folder"; then
      printf '%s\n' "$folder"
      return
    fi
    if [ -e "$folder/cert.pem" ] && serves_still; then
      printf '%s\n' "$SERVED"
      return
    fi
  done
  printf '%s\n' "$SELF_SIGNED"
}

# Browsers remember for months that this host has a real certificate, so only a real one says it.
strict_transport() {
  if cmp -s "$SERVED/cert.pem" "$SELF_SIGNED/cert.pem"; then echo /etc/nginx/hsts-off.conf; else echo /etc/nginx/hsts-on.conf; fi
}

is_served() { # folder
  cmp -s "$1/cert.pem" "$SERVED/cert.pem" && cmp -s "$1/key.pem" "$SERVED/key.pem"
}

serve() { # folder
  if ! is_served "$1"; then
    (umask 077 && cp "$1/key.pem" "$SERVED/key.new" && cp "$1/cert.pem" "$SERVED/cert.new")
    mv "$SERVED/key.new" "$SERVED/key.pem"
    mv "$SERVED/cert.new" "$SERVED/cert.pem"
  fi
  ln -sfn "$(strict_transport)" /run/nginx/hsts.conf
  echo "nginx: serving the certificate in $1, $(openssl x509 -in "$SERVED/cert.pem" -noout -fingerprint -sha256)" >&2
}

# What serves was tried when it began to, maybe under another PUBLIC_HOST.
report_served() {
  if cmp -s "$SERVED/cert.pem" "$SELF_SIGNED/cert.pem"; then return; fi
  if reason=$(/usr/lib/robotether/try-certificate "$SERVED/cert.pem" "$SERVED/key.pem" "${PUBLIC_HOST:-}"); then return; fi
  echo "nginx: the certificate that serves would not be taken now: $reason. It stays in force until there is another one." >&2
}

# A reload lets open connections end by themselves on the certificate that they began with.
watch_certificates() {
  while sleep "$LOOK_EVERY_S"; do
    folder=$(chosen)
    if ! is_served "$folder"; then
      serve "$folder"
      nginx -t -q && nginx -s reload
    fi
  done
}
