# Reads a setting that lists networks; sourced by entrypoint.sh and direct.sh, whose `fail` it calls. Only what an address or
# a network in CIDR notation is made of gets into nginx's configuration.
# shellcheck shell=sh
list_networks() { # setting value
  case "$2" in
    *[!0-9a-fA-F.:/,\ ]*) fail "$1 is '$2'; allowed are networks such as 192.0.2.0/24, with commas between" ;;
  esac
  for network in $(echo "$2" | tr , ' '); do
    case "$network" in
      */0 | 0.0.0.0* | ::/*) fail "$1 has '$network', which is everybody; name your own network" ;;
    esac
    echo "$network"
  done
}
