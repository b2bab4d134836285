# Which certificate serves; sourced by entrypoint.sh. nginx reads one pair in /run/nginx/tls, which is put there from the
# first of these that holds: the admin's own (a folder that compose's service secrets fills), the one from the ACME authority (the service
# acme), the self-signed one. A pair that does not hold, such as one of which only half has been copied, changes nothing.
# shellcheck shell=sh

readonly SELF_SIGNED=/etc/nginx/tls
readonly OWN=/etc/nginx/own
readonly ACME=/etc/nginx/acme/current
readonly SERVED=/run/nginx/tls
readonly LOOK_EVERY_S=2

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
    -subj "/CN=$1" -addext "subjectAltName=$(subject_alternative_names "$1")" \
    -addext basicConstraints=critical,CA:FALSE -addext keyUsage=critical,digitalSignature \
    -addext extendedKeyUsage=serverAuth \
    -keyout "$SELF_SIGNED/key.pem.new" -out "$SELF_SIGNED/cert.pem.new" 2>/dev/null
  chmod 600 "$SELF_SIGNED/key.pem.new"
  # The key first: a pair is complete once the certificate is there.
  mv "$SELF_SIGNED/key.pem.new" "$SELF_SIGNED/key.pem"
  mv "$SELF_SIGNED/cert.pem.new" "$SELF_SIGNED/cert.pem"
}

public_key_of_certificate() { openssl x509 -in "$1" -noout -pubkey 2>/dev/null; }
public_key_of_key() { openssl pkey -in "$1" -pubout 2>/dev/null; }

holds() { # folder: a certificate that has not ended, and its key
  [ -s "$1/cert.pem" ] && [ -s "$1/key.pem" ] &&
    openssl x509 -in "$1/cert.pem" -noout -checkend 0 >/dev/null 2>&1 &&
    [ "$(public_key_of_certificate "$1/cert.pem")" = "$(public_key_of_key "$1/key.pem")" ]
}

# While a better pair is being replaced, what serves goes on.
chosen() { # prints the folder of the pair that is to serve
  for folder in "$OWN" "$ACME"; do
    if holds "$folder"; then
      printf '%s\n' "$folder"
      return
    fi
    if [ -e "$folder/cert.pem" ] && holds "$SERVED"; then
      printf '%s\n' "$SERVED"
      return
    fi
  done
  printf '%s\n' "$SELF_SIGNED"
}

# Browsers remember for months that this host has a real certificate, so only a real one says it.
strict_transport() { # folder
  if [ "$1" = "$SELF_SIGNED" ]; then echo /etc/nginx/hsts-off.conf; else echo /etc/nginx/hsts-on.conf; fi
}

is_served() { # folder
  cmp -s "$1/cert.pem" "$SERVED/cert.pem" && cmp -s "$1/key.pem" "$SERVED/key.pem"
}

serve() { # folder
  (umask 077 && mkdir -p "$SERVED")
  (umask 077 && cp "$1/key.pem" "$SERVED/key.new" && cp "$1/cert.pem" "$SERVED/cert.new")
  mv "$SERVED/key.new" "$SERVED/key.pem"
  mv "$SERVED/cert.new" "$SERVED/cert.pem"
  ln -sfn "$(strict_transport "$1")" /run/nginx/hsts.conf
  echo "nginx: serving the certificate in $1, $(openssl x509 -in "$SERVED/cert.pem" -noout -fingerprint -sha256)"
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
