"""`show-settings` of the agent, as a terminal shows it."""

import subprocess
import sys
from pathlib import Path

from transcripts import Transcript

ROOT = Path(__file__).resolve().parents[3]
AGENT_SETTINGS = {
    "server": "robots.example:8443",
    "tls_fingerprint": "ab" * 32,
    "ssh_host": "ssh.robots.example",
    "ssh_ports": "2222,443",
    "http_proxy": "http://me:secret@proxy.example:3128",
    "interface": "eth0",
    "allow_local_mac": "yes",
    "name": "turtle",
    "video_source": "rosbridge",
    "video_encoder": "off",
    "cameras": "front=http://me:secret@10.0.0.7/1 back=http://127.0.0.1:81/stream",
    "guard": "off",
    "token": "rtj_secret",
    "log_level": "debug",
}


def test_agent_hides_secrets(recorded):
    """The token is hidden, and so are passwords in URLs."""
    environ = {f"ROBOTETHER_{key.upper()}": value for key, value in AGENT_SETTINGS.items()}
    done = subprocess.run(
        [sys.executable, "-m", "robotether_agent", "show-settings"],
        env=environ | {"PYTHONPATH": f"{ROOT / 'agent'}:{ROOT / 'common'}"},
        check=False,
        capture_output=True,
        text=True,
    )
    transcript = Transcript()
    for name, value in environ.items():
        transcript.add(f"$ {name}={value}")
    transcript.add("$ show-settings", done.stdout.rstrip())
    transcript.add(f"exit status {done.returncode}", done.stderr.rstrip())
    assert transcript == recorded
