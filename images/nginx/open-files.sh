# Raises the number of files that a process may have open to what nginx's connections need, as far as it is allowed here;
# sourced by entrypoint.sh and direct.sh. Docker 29 lets a container begin with 1024. nginx itself would log an alert where
# the limit is lower.
# shellcheck shell=sh
readonly OPEN_FILES=16384
raise_open_files() {
  highest=$(ulimit -H -n)
  if [ "$highest" = unlimited ] || [ "$highest" -ge "$OPEN_FILES" ]; then highest=$OPEN_FILES; fi
  ulimit -S -n "$highest"
}
