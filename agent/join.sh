#!/bin/sh
# Makes this machine a robot of a Robotether server: installs the agent, joins, and starts the boot service.
# The server serves it as /join.sh; `robotether robot invite` and the admin page print the line that runs it:
#   curl -fsSk --pinnedpubkey 'sha256//...' https://HOST/join.sh | sudo sh -s -- --server HOST --token rj_...
# It checks everything before it changes anything. What fails later undoes what this run made, and the same line
# may be run again: it finishes the work, upgrades the agent, or finds nothing to do.
# It is long for one file, because one file is what a pipe carries.

PROGRAM=join.sh
ROOT=/opt/robotether-agent
CONFIG=/etc/robotether/agent.toml
TOKEN=/etc/robotether/token
STATE=/var/lib/robotether-agent
UNIT=/etc/systemd/system/robotether-agent.service
LINK=/usr/local/bin/robotether-agent
ACCOUNT=robotether
AGENT=$ROOT/current/bin/robotether-agent
NEEDED_MB=150
WAIT_S=30

usage() {
  cat <<'TEXT'
usage: join.sh --server HOST[:PORT] [options]     make this machine a robot of that server; run again to upgrade
       join.sh --uninstall [--yes]                remove all that it installed, the robot's key too

  --tls-fingerprint HEX64  trust the server's certificate with this SHA-256, and no other
  --token rj_...           join token: admits the robot without an approval
  --name NAME              name that a new robot asks for; needs a token
  --interface IF           network interface whose MAC names the robot (usually found by itself)
  --mac MAC                the MAC that names the robot
  --allow-local-mac        a locally administered MAC may name it
  --rosbridge-url URL      where rosbridge is, if not at ws://127.0.0.1:9090
  --no-guard               a bare forward to rosbridge: nothing stops the robot when its commands stop
  --no-video               leave out PyAV, which encodes H.264: cameras send JPEG (video_encoder = "off" in the settings)
  --http-proxy URL         http://[USER:PASSWORD@]HOST:PORT that the agent and this line go through to the server; pip and
                           apt go by https_proxy
  --wheelhouse DIR         take Python packages from this folder, not from the internet
  --image                  prepare an SD card image: install and enable, but neither join nor start
  --package DIR            as the .deb does: install from this folder, and neither join nor use the network
TEXT
}

say() { printf '%s: %s\n' "$PROGRAM" "$*"; }
step() { did=1; say "$*"; }
fail() { printf '%s: %s\n' "$PROGRAM" "$*" >&2; exit 1; }

# --- what this run made, and how to take it back ---

on_failure() { # a command, run in reverse order if a later step fails
  undo_steps="$1
$undo_steps"
}

keep_copy() { # file: a later failure brings it back as it was
  if [ ! -e "$1" ]; then on_failure "rm -f $1"; return; fi
  cp -p "$1" "$1.before"
  on_failure "mv -f $1.before $1"
}

finished() {
  undo_steps=''
  rm -f "$CONFIG.before" "$TOKEN.before"
}

at_exit() {
  status=$?
  trap - EXIT
  trap '' HUP INT TERM
  if [ -n "$work" ]; then rm -rf "$work"; fi
  if [ "$status" != 0 ] && [ -n "$undo_steps" ]; then
    printf '%s' "$undo_steps" | while IFS= read -r step; do eval "$step" || true; done
    say "undid what this run had changed. Fix the cause, then run ${package:+dpkg --configure -a, or }the same line again" >&2
  fi
  exit "$status"
}

# --- the options ---

read_options() {
  server='' fingerprint='' token='' name='' interface='' mac='' local_mac='' rosbridge='' wheelhouse='' proxy='' no_guard='' no_video=''
  image='' package='' uninstall='' yes=''
  while [ $# -gt 0 ]; do
    case $1 in
      --server | --tls-fingerprint | --token | --name | --interface | --mac | --rosbridge-url | --http-proxy | --wheelhouse | --package)
        [ $# -ge 2 ] || fail "cannot use $1: its value is missing"
        take_value "$1" "$2"; shift
        ;;
      --allow-local-mac) local_mac=true ;;
      --no-guard) no_guard=1 ;;
      --no-video) no_video=1 ;;
      --image) image=1 ;;
      --uninstall) uninstall=1 ;;
      --yes) yes=1 ;;
      --help) usage; exit 0 ;;
      *) usage >&2; fail "cannot use $1: there is no such option" ;;
    esac
    shift
  done
}

# The values become lines of a TOML file and arguments: none needs a quote, a blank or a backslash.
take_value() {
  case $2 in
    '' | -* | *[!A-Za-z0-9._:/@+=,%[\]-]*) fail "cannot use $1 '$2': allowed are letters, digits and ._:/@+=,%[]-" ;;
  esac
  case $1 in
    --server) server=$2 ;;
    --tls-fingerprint) fingerprint=$(printf '%s' "$2" | tr -d : | tr 'A-F' 'a-f') ;;
    --token) token=$2 ;;
    --name) name=$2 ;;
    --interface) interface=$2 ;;
    --mac) mac=$2 ;;
    --rosbridge-url) rosbridge=$2 ;;
    --http-proxy) proxy=$2 ;;
    --wheelhouse) wheelhouse=$2 ;;
    --package) package=$2 wheelhouse=$2 ;;
  esac
}

configured() { # key: its value in the settings of a robot that is installed already
  if [ ! -e "$CONFIG" ]; then return; fi
  sed -n -e "s/^$1[[:space:]]*=[[:space:]]*\"\([^\"]*\)\".*/\1/p" -e "s/^$1[[:space:]]*=[[:space:]]*'\([^']*\)'.*/\1/p" "$CONFIG"
}

check_options() {
  before=$(configured server)
  server=${server:-$before}
  # The settings beside a package are a person's, and the agent itself checks them.
  if [ -n "$package" ]; then return; fi
  [ -n "$server" ] || { usage >&2; fail 'cannot install: --server is missing'; }
  case $server in *://* | */*) fail "cannot use --server $server: allowed is HOST or HOST:PORT, without https:// and path" ;; esac
  # What an earlier run pinned still holds for the same server.
  if [ -z "$fingerprint" ] && [ "$server" = "$before" ]; then fingerprint=$(configured tls_fingerprint); fi
  printf '%s\n' "$fingerprint" | grep -qE '^([0-9a-f]{64})?$' ||
    fail "cannot use --tls-fingerprint $fingerprint: allowed are 64 hexadecimal digits, as the server prints them"
  case $token in '' | rj_* | rt_*) ;; *) fail 'cannot use this --token: a join token begins with rj_; copy the whole line again' ;; esac
  case $rosbridge in '' | ws://*) ;; *) fail "cannot use --rosbridge-url $rosbridge: allowed is ws://HOST:PORT" ;; esac
  if [ -n "$mac" ] && [ -n "$interface" ]; then fail 'cannot use both --mac and --interface: leave one out'; fi
  if [ -n "$name" ] && [ -z "$token" ]; then fail 'cannot use --name without --token: an admin names the robots that wait for approval'; fi
  if [ -n "$wheelhouse" ] && [ ! -d "$wheelhouse" ]; then fail "cannot use --wheelhouse $wheelhouse: there is no such folder"; fi
  if [ -n "$image" ]; then check_image_options; fi
}

# Python looks for modules where it is started, and runs as root here: not in a folder that anybody may write in.
leave_this_folder() {
  if [ -n "$wheelhouse" ]; then wheelhouse=$(cd "$wheelhouse" && pwd); fi
  if [ -n "$package" ]; then package=$wheelhouse; fi
  cd /
}

check_image_options() {
  case $token in rt_*) fail 'cannot put an API token into an image: whoever has a card could do with it all that its user may. Use a join token (rj_...)' ;; esac
  if [ -n "$mac$name" ]; then fail 'cannot use --mac or --name with --image: every clone would be the same robot'; fi
  if [ -e "$STATE/id_ed25519" ]; then
    fail "cannot make an image of this machine: it has a robot's key, which every clone would have. As root, run:" \
      "systemctl stop robotether-agent; $AGENT forget --yes; then this line again"
  fi
}

# --- the look at the machine, which changes nothing ---

check_machine() {
  [ "$(id -u)" = 0 ] || fail 'cannot install as an ordinary user: run it with sudo'
  command -v systemctl >/dev/null 2>&1 ||
    fail 'cannot install: this machine has no systemd, which starts the agent at boot. Install by hand, as agent/README.md says'
  # Nothing runs yet that had to be switched over: the package puts its version in place, as into an image.
  if [ -n "$package" ] && { [ -z "$server" ] || [ ! -d /run/systemd/system ]; }; then image=1; fi
  # An image is often made in a chroot, where systemd is installed but does not run.
  [ -n "$image" ] || [ -d /run/systemd/system ] ||
    fail 'cannot install: systemd does not run here (in a container or chroot?). For an SD card image, add --image'
  exec 9</var/lib
  flock -n 9 || fail 'cannot install: another run of this script is busy here; wait until it is done'
  check_disk "$ROOT" 1
  check_disk "$STATE" 10
  check_disk /etc 1
}

check_disk() { # folder, MB
  folder=$1
  until [ -d "${folder:=/}" ]; do folder=${folder%/*}; done
  [ -w "$folder" ] || fail "cannot write in $folder: is the disk mounted read-only?"
  free=$(df -Pk "$folder" | awk 'NR == 2 { print int($4 / 1024) }')
  [ "$free" -ge "$2" ] || fail "cannot install: $folder has $free MB free, and $2 MB are needed. Free some space"
}

find_missing_packages() {
  missing=''
  if command -v python3 >/dev/null 2>&1; then check_python; else missing='python3'; fi
  python3 -c 'import ensurepip, venv' 2>/dev/null || missing="$missing python3-venv"
  if ! command -v ssh >/dev/null 2>&1 || ! command -v ssh-keygen >/dev/null 2>&1; then missing="$missing openssh-client"; fi
  if [ -n "$missing" ] && { [ -n "$package" ] || ! command -v apt-get >/dev/null 2>&1; }; then
    fail "cannot install: these are missing, and apt-get cannot get them here: $missing. Install them, then run this again"
  fi
}

check_python() {
  python3 -c 'import sys; sys.exit(sys.version_info < (3, 10))' ||
    fail "cannot install: this machine has $(python3 --version 2>&1), and 3.10 is needed. Upgrade to Debian 12, Ubuntu 22.04, Raspberry Pi OS 12 or newer"
}

# --- what the server gives ---

# Prints an error in a clause. The certificate is checked on the very connection that the file comes over.
fetch() { # path, file
  # As the agent will go, else by https_proxy. In the environment, since it may have a password.
  through=${proxy:-$(configured http_proxy)}
  if [ -n "$through" ]; then export https_proxy="$through" no_proxy=''; fi
  python3 - "$server" "$fingerprint" "$1" "$2" <<'PYTHON'
import base64
import hashlib
import hmac
import http.client
import ssl
import sys
import time
from urllib.parse import unquote, urlsplit
from urllib.request import getproxies_environment, proxy_bypass_environment

LIMIT = 64 * 1024 * 1024
server, fingerprint, path, target = sys.argv[1:]
context = ssl.create_default_context()
if fingerprint:
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE


def connection_to(host, port):
    proxy = getproxies_environment().get("https", "")
    if not proxy or proxy_bypass_environment(host):
        return http.client.HTTPSConnection(host, port, timeout=30, context=context)
    found = urlsplit(proxy if "://" in proxy else f"http://{proxy}")
    login = f"{unquote(found.username or '')}:{unquote(found.password or '')}"
    headers = {"Proxy-Authorization": f"Basic {base64.b64encode(login.encode()).decode()}"} if found.username else {}
    connection = http.client.HTTPSConnection(found.hostname, found.port, timeout=30, context=context)
    connection.set_tunnel(host, port, headers)
    return connection


try:
    where = urlsplit(f"//{server}")
    connection = connection_to(where.hostname, where.port or 443)
    connection.connect()
    found = hashlib.sha256(connection.sock.getpeercert(True)).hexdigest()
    if fingerprint and not hmac.compare_digest(found, fingerprint):
        sys.exit(f"its certificate has the SHA-256 {found}, not {fingerprint}. Copy the line again from the server's page; if it is the same there, something stands between")
    connection.request("GET", path, headers={"User-Agent": "robotether-join"})
    answer = connection.getresponse()
    body = answer.read(LIMIT + 1)
except ssl.SSLCertVerificationError as error:
    today = time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime())
    sys.exit(f"{error.verify_message}. Add --tls-fingerprint, and see that this machine's clock is right (it says {today})")
except (OSError, ValueError, http.client.HTTPException) as error:
    # Of a library's own text a proxy's refusal alone: there may be a class in it, or a line of its source.
    reason = f"TLS fails ({error.reason})" if isinstance(error, ssl.SSLError) else getattr(error, "strerror", None)
    if isinstance(error, TimeoutError) or str(error).startswith("Tunnel connection failed"):
        reason = str(error)
    sys.exit(f"{reason or 'nothing there speaks HTTPS'}. Check --server, and this machine's network")
if answer.status != 200 or len(body) > LIMIT:
    sys.exit(f"{path} answers with HTTP status {answer.status}. Is this a Robotether server, and of this version?")
with open(target, "wb") as file:
    file.write(body)
PYTHON
}

get() { # path, file; a package has all files
  if [ -n "$package" ]; then return; fi
  why=$(fetch "$1" "$2" 2>&1) || fail "cannot get https://$server$1: $why"
}

find_agent() {
  if [ -z "$package" ]; then say "asking $server for the agent"; fi
  get /agent/manifest "$files/manifest"
  wheel=$(awk '$2 ~ /^robotether_agent-[A-Za-z0-9.+_-]+\.whl$/ { print $2 }' "$files/manifest")
  if grep -qvE '^[0-9a-f]{64}  [A-Za-z0-9._+-]+$' "$files/manifest" || [ -z "$wheel" ]; then
    fail "cannot install from $server: something other than a Robotether server answers there (a captive portal?)"
  fi
  for file in "$wheel" requirements.txt; do get "/agent/$file" "$files/$file"; done
  (cd "$files" && sha256sum --check --status --strict manifest) ||
    fail "cannot use what $server sent: a file is not what its manifest says. Run this again"
  version=${wheel#robotether_agent-}
  version=${version%%-*}-$(cut -c 1-64 "$files/manifest" | sha256sum | cut -c 1-12)
  venv=$ROOT/versions/$version
}

is_installed() { "$venv/bin/robotether-agent" --version >/dev/null 2>&1; }
check_room() { is_installed || check_disk "$ROOT" "$NEEDED_MB"; }

# The agent's own rule, taken from the wheel as it is: what it finds here names the robot later.
check_mac() {
  if [ -n "$image$package" ] || { [ -e "$STATE/identity.json" ] && [ -z "$mac$interface" ]; }; then return; fi
  why=$(PYTHONPATH=$files/$wheel python3 - "$mac" "$interface" "${local_mac:-$(configured_flag allow_local_mac)}" 2>&1 <<'PYTHON'
import sys

from robotether_agent.enrolment.identity import find_interface
from robotether_agent.fields import MacError, normalise_mac
from robotether_agent.problems import InterfaceMissingError

mac, interface, allow_local = sys.argv[1], sys.argv[2] or None, sys.argv[3] == "true"
try:
    print(normalise_mac(mac, allow_local=allow_local) if mac else find_interface(interface, allow_local=allow_local).mac)
except MacError as error:
    sys.exit(f"cannot name this robot by its MAC address: {error}")
except InterfaceMissingError as problem:
    sys.exit(problem.message)
PYTHON
  ) || fail "$why. Choose with --interface IF or --mac MAC; for a locally administered address that is unique, add --allow-local-mac"
  say "the MAC address $why names this robot"
}

configured_flag() { if grep -qs "^$1[[:space:]]*=[[:space:]]*true" "$CONFIG"; then echo true; fi; }

# --- the changes, each safe to repeat ---

ensure_packages() {
  if [ -z "$missing" ]; then return; fi
  step "installing the distribution's packages $missing (they stay, whatever happens later)"
  export DEBIAN_FRONTEND=noninteractive
  apt-get update -qq </dev/null || fail "cannot fetch apt's lists: see above; $clock"
  # shellcheck disable=SC2086 # a list of words
  apt-get install -y -qq --no-install-recommends $missing </dev/null >/dev/null ||
    fail "cannot install $missing: see apt's message above"
  check_python
  missing=''
}

ensure_account() {
  if id "$ACCOUNT" >/dev/null 2>&1; then return; fi
  step "making the user $ACCOUNT, as whom the agent runs"
  on_failure "userdel $ACCOUNT"
  useradd --system --user-group --home-dir "$STATE" --no-create-home --shell /usr/sbin/nologin "$ACCOUNT" ||
    fail "cannot create the user $ACCOUNT: see above"
}

ensure_agent() {
  if is_installed; then return; fi
  step "installing the agent into $venv (a minute on a small robot)"
  if [ -d "$ROOT" ]; then on_failure "rm -rf $venv"; else on_failure "rm -rf $ROOT"; fi
  rm -rf "$venv"
  mkdir -p "$ROOT/versions"
  if [ -n "$wheelhouse" ]; then set -- --no-index --find-links "$wheelhouse"; else set --; fi
  PYTHONPATH=$files/$wheel python3 -m robotether_agent.install \
    "$venv" "$files/$wheel" "$files/requirements.txt" --no-cache-dir "$@" ||
    fail "cannot install the Python packages: see above; $clock. Without internet, install the server's /agent.deb first, or use --wheelhouse DIR"
}

has_video() {
  set -- "$venv"/lib/python3*/site-packages/av-*.dist-info
  [ -e "$1" ]
}

# With one core the agent does not encode. A robot works without it, so a failure is no reason to stop.
ensure_video() {
  if [ -n "$no_video" ] || [ "$(configured video_encoder)" = off ] || [ "$(nproc)" = 1 ] || has_video; then return; fi
  if [ -n "$wheelhouse" ]; then set -- --wheelhouse "$wheelhouse"; else set --; fi
  say 'installing PyAV, which encodes H.264 (some 100 MB; --no-video leaves it out)'
  if why=$("$venv/bin/robotether-agent" install-video "$@" 2>&1); then did=1; return; fi
  say "${why#robotether-agent: }. Without it cameras send JPEG, and nothing else changes. Later: sudo robotether-agent install-video"
}

# All keys of agent.toml are flat, so their order is free; what a person wrote there stays.
set_key() { # file, key, value as TOML
  if grep -qxF "$2 = $3" "$1"; then return; fi
  remove_key "$1" "$2"
  printf '%s = %s\n' "$2" "$3" >> "$1"
}

set_text() { if [ -n "$3" ]; then set_key "$1" "$2" "\"$3\""; fi; }
remove_key() { sed -i "/^$2[[:space:]]*=/d" "$1"; }

write_config() { # file
  # Whatever editor a person has: the last line ends, too.
  # shellcheck disable=SC1003 # the backslash is sed's
  if [ -e "$CONFIG" ]; then sed '$a\' "$CONFIG" > "$1"; else echo '# Every key is explained in share/robotether-agent/agent.toml.example beside the agent.' > "$1"; fi
  if [ "$(configured server)" != "$server" ]; then remove_key "$1" tls_fingerprint; fi
  if [ -n "$fingerprint" ]; then remove_key "$1" ca_file; fi
  if [ -n "$mac" ]; then remove_key "$1" interface; fi
  if [ -n "$interface" ]; then remove_key "$1" mac; fi
  set_text "$1" server "$server"
  set_text "$1" tls_fingerprint "$fingerprint"
  set_text "$1" mac "$mac"
  set_text "$1" interface "$interface"
  set_text "$1" name "$name"
  set_text "$1" rosbridge_url "$rosbridge"
  set_text "$1" http_proxy "$proxy"
  if [ -n "$no_guard" ]; then set_text "$1" guard off; fi
  if [ -n "$no_video" ]; then set_text "$1" video_encoder off; fi
  if [ -n "$local_mac" ]; then set_key "$1" allow_local_mac true; fi
  if [ -n "$token" ]; then remove_key "$1" token; set_text "$1" token_file "$TOKEN"; fi
}

# What holds a secret is root's and the agent's only.
protect() { # file
  # A URL of a proxy or a camera may have a password.
  if ! grep -qsE '^(rj_|rt_|token[[:space:]]*=|[^#]*://[^/"]*@)' "$1"; then return; fi
  chgrp "$ACCOUNT" "$1"
  chmod 640 "$1"
}

ensure_config() {
  changed=''
  # A person wrote the settings, if there are any, before there was the agent's user.
  if [ -n "$package" ]; then protect "$CONFIG"; protect "$TOKEN"; return; fi
  # A robot that is connected to this server needs no token: the same line, run twice, changes nothing.
  if [ -n "$token" ] && [ -z "$image" ] && [ "$server" = "$before" ] && "$AGENT" status >/dev/null 2>&1; then token='' name=''; fi
  write_config "$work/agent.toml"
  if [ -z "$token" ] && cmp -s "$work/agent.toml" "$CONFIG"; then return; fi
  changed=1
  step "writing $CONFIG"
  if [ -d /etc/robotether ]; then keep_copy "$CONFIG"; keep_copy "$TOKEN"; else on_failure 'rm -rf /etc/robotether'; fi
  install -d -m 755 /etc/robotether
  protect "$work/agent.toml"
  # In one step: never without its end, and never for others to read.
  cp -p "$work/agent.toml" "$CONFIG.new"
  mv -f "$CONFIG.new" "$CONFIG"
  if [ -z "$token" ]; then return; fi
  install -m 640 -o root -g "$ACCOUNT" /dev/null "$TOKEN"
  printf '%s\n' "$token" > "$TOKEN"
}

ensure_join() {
  answer='' pending=''
  if [ -n "$image$package" ] || { [ -z "$changed" ] && [ -e "$STATE/enrolment.json" ]; }; then return; fi
  if [ ! -d "$STATE" ]; then on_failure "rm -rf $STATE"; fi
  step "joining $server"
  result=0
  answer=$("$venv/bin/robotether-agent" join 2>&1) || result=$?
  case $result in
    0) if [ -e "$TOKEN" ]; then rm -f "$TOKEN"; remove_key "$CONFIG" token_file; fi ;;
    10) pending=1 ;;
    *) fail "${answer#robotether-agent: }" ;;
  esac
}

ensure_unit() {
  unit=$venv/share/robotether-agent/robotether-agent.service
  first=''
  [ -e "$UNIT" ] || first=1
  # On a robot that runs, `switch` brings the new unit.
  if cmp -s "$unit" "$UNIT" || { [ -e "$UNIT" ] && [ -z "$image" ]; }; then return; fi
  step 'installing the boot service robotether-agent'
  on_failure 'systemctl daemon-reload'
  on_failure "rm -f $UNIT"
  install -m 644 "$unit" "$UNIT"
}

ensure_link() {
  if [ -e "$LINK" ] || [ -L "$LINK" ]; then return; fi
  on_failure "rm -f $LINK"
  ln -s "$AGENT" "$LINK"
}

is_current() { [ "$(readlink -f "$ROOT/current")" = "$venv" ]; }

point_current_here() {
  ln -sfn "versions/$version" "$ROOT/current.new"
  mv -T "$ROOT/current.new" "$ROOT/current"
  install -m 644 "$unit" "$UNIT"
}

ensure_running() {
  # An agent that does not start, as after an upgrade of the distribution to another Python, cannot switch either.
  if [ -n "$image" ] || ! "$AGENT" --version >/dev/null 2>&1; then point_current_here; fi
  if [ -d /run/systemd/system ]; then systemctl daemon-reload; fi
  # A package neither enables nor starts what a person disabled or stopped, or what has no server yet.
  if [ -z "$package" ] || [ -n "$first" ]; then wanted=$server; else wanted=''; fi
  [ -z "$wanted" ] || systemctl --quiet is-enabled robotether-agent 2>/dev/null || systemctl --quiet enable robotether-agent ||
    fail 'cannot enable the boot service: see above; fix it and run this again'
  if [ -n "$image" ]; then return; fi
  if ! is_current; then
    step "switching from $(basename "$(readlink "$ROOT/current")") to $version"
    # Not a child of this shell: the connection over which it runs may be the robot's own tunnel.
    systemd-run --quiet --wait --pipe --collect "$AGENT" switch "$venv" ||
      fail "cannot upgrade to $version: see above, and journalctl -u robotether-agent"
    # `switch` has restarted an agent that ran, and does not start one that had failed.
    changed=''
  fi
  if [ -n "$changed" ] || { [ -n "$wanted" ] && ! systemctl --quiet is-active robotether-agent; }; then
    step 'starting the agent'
    # A wrong setting is no reason to leave a package half installed; systemctl says what to look at.
    systemctl restart robotether-agent || [ -n "$package" ] || fail 'cannot start the agent: see journalctl -u robotether-agent'
  fi
}

# --- what comes next ---

tell_result() {
  if [ -n "$package" ]; then
    tell_about_package
  elif [ -n "$image" ]; then
    say 'done: the image is ready. Power off and copy the card; each clone makes its own key at its first boot (docs/howto/golden-image.md)'
  elif [ -n "$pending" ]; then
    tell_how_to_approve
  elif wait_connected; then
    if [ -z "$did" ]; then say 'nothing to do: all is installed as it should be'; fi
    robot=$(sed -n 's/.*"robot": "\([^"]*\)".*/\1/p' "$STATE/enrolment.json")
    say "done: this robot is $robot, at https://$server/robots/$robot"
    grep -q '^rosbridge *ok' "$work/status" ||
      say "rosbridge has not answered yet ($(sed -n 's/^rosbridge *//p' "$work/status")): start it whenever you like, nothing else is needed"
    sed -n 's/^warning */WARNING: /p' "$work/status" | while read -r line; do say "$line"; done
  else
    cat "$work/status" >&2
    fail "cannot see it connected after $WAIT_S s. The agent is installed and keeps trying; find out why: $AGENT doctor"
  fi
}

tell_about_package() {
  if [ -n "$server" ]; then
    say "done: $version is installed; 'robotether-agent status' says how the agent is"
  else
    say "done: $version is installed, and has no server yet. Run the server's install line, or write $CONFIG and run:" \
      'systemctl enable --now robotether-agent'
  fi
}

wait_connected() {
  left=$WAIT_S
  until "$AGENT" status > "$work/status" 2>&1; do
    left=$((left - 1))
    [ "$left" -gt 0 ] || return 1
    sleep 1
  done
}

tell_how_to_approve() {
  say "$answer"
  say "the key of this robot is $(ssh-keygen -lf "$STATE/id_ed25519.pub" | cut -d ' ' -f 2)"
  say "done: an admin approves it at https://$server/admin/add-robot, or with 'robotether robot approve', after comparing that key." \
    'The agent runs and asks by itself'
}

# --- the way back ---

uninstall() {
  [ "$(id -u)" = 0 ] || fail 'cannot uninstall as an ordinary user: run it with sudo'
  # dpkg would go on to know files that are gone.
  if dpkg-query --show --showformat '${db:Status-Status}\n' robotether-agent 2>/dev/null | grep -qvxE 'not-installed|config-files'; then
    fail 'cannot remove what a Debian package has installed: run apt purge robotether-agent, which removes the key too'
  fi
  found=''
  # Left by an upgrade that a power cut ended.
  pending=robotether-agent-unfinished-switch.service
  for path in "$UNIT" "${UNIT%/*}/$pending" "${UNIT%/*}/multi-user.target.wants/$pending" \
    "$LINK" "$ROOT" /etc/robotether "$STATE" /run/robotether-agent; do
    if [ -e "$path" ] || [ -L "$path" ]; then found="$found $path"; fi
  done
  account=''
  if id "$ACCOUNT" >/dev/null 2>&1; then account=" and the user $ACCOUNT"; fi
  if [ -z "$found$account" ]; then say 'nothing to do: no agent is installed here'; return; fi
  say "this stops the agent and removes$found$account. The robot's key goes with them, and cannot be brought back"
  [ -n "$yes" ] || ask
  for service in "$pending" robotether-agent; do systemctl --quiet disable --now "$service" 2>/dev/null || true; done
  # shellcheck disable=SC2086 # a list of our own paths
  rm -rf $found
  systemctl daemon-reload 2>/dev/null || true
  if [ -n "$account" ]; then userdel "$ACCOUNT" || fail "cannot remove the user $ACCOUNT: see above"; fi
  say 'done: removed. The server still knows the robot; an admin forgets it with: robotether robot remove NAME'
}

# Standard input is the script itself when it came through a pipe.
ask() {
  if ! (: < /dev/tty) 2>/dev/null; then fail 'cannot ask whether to remove it: no terminal. Add --yes'; fi
  printf '%s: remove all that? [y/N] ' "$PROGRAM" > /dev/tty
  read -r reply < /dev/tty
  case $reply in [yY]*) ;; *) fail 'nothing changed' ;; esac
}

main() {
  set -eu
  umask 022
  work='' undo_steps='' did='' clock="this machine's clock says $(date -u '+%F %R') UTC (a wrong one makes certificates invalid)"
  trap at_exit EXIT
  trap 'exit 130' HUP INT TERM
  read_options "$@"
  if [ -n "$uninstall" ]; then uninstall; return; fi
  check_options
  leave_this_folder
  check_machine
  find_missing_packages
  work=$(mktemp -d)
  # Without Python there is no looking at the server.
  case $missing in python3*) check_disk "$ROOT" "$NEEDED_MB"; ensure_packages ;; esac
  files=${package:-$work}
  find_agent
  check_room
  check_mac
  ensure_packages
  ensure_account
  ensure_agent
  ensure_video
  ensure_config
  ensure_unit
  ensure_link
  # The last step that can be undone: once the server knows the key, the key stays.
  ensure_join
  finished
  ensure_running
  tell_result
}

main "$@"
