# Looks at a machine that may have no Python, and prints NAME=VALUE lines. Runs through Ansible's raw; changes nothing.
has() { command -v "$1" >/dev/null 2>&1 && echo yes || echo no; }
[ -d /run/systemd/system ] && echo systemd=yes || echo systemd=no
echo "python=$(python3 -c 'import sys; print("%d.%d.%d" % sys.version_info[:3])' 2>/dev/null)"
python3 -c 'import ensurepip, venv' 2>/dev/null && echo venv=yes || echo venv=no
echo "ssh=$(has ssh-keygen)"
echo "cores=$(nproc)"
echo "apt=$(has apt-get)"
docker info >/dev/null 2>&1 && echo docker=yes || echo docker=no
echo "docker_root=$(docker info 2>/dev/null | sed -n 's/^ *Docker Root Dir: //p')"
python3 -c 'import requests' 2>/dev/null && echo requests=yes || echo requests=no
echo "hostname=$(uname -n)"
[ -e /etc/systemd/system/robotether-agent.service ] && echo installed=yes || echo installed=no
[ -e /var/lib/robotether-agent/id_ed25519 ] && echo key=yes || echo key=no
echo "current=$(readlink /opt/robotether-agent/current 2>/dev/null)"
