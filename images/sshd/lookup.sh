# shellcheck shell=sh
# What authorized-keys and jump-keys share; both start it with `.` and run as user `keylookup`.

# Nothing but base64 may reach an SQL statement or a file's name.
is_fingerprint() { # SHA256:...
  case "${1#SHA256:}" in
    "$1" | '' | *[!A-Za-z0-9+/]*) return 1 ;;
  esac
}

ask() { # SQL; --skip-ssl: the network `data` exists on this host only, and a handshake costs 3 ms a login
  read -r password < /run/secrets/mysql_keylookup_password || [ -n "$password" ] || return
  MYSQL_PWD=$password mariadb \
    --defaults-file=/etc/robotether/keylookup.cnf --batch --raw --skip-column-names --execute "$1" 2>&1
}
