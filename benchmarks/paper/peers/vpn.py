"""Networks laid over the link by other people's programs: WireGuard in user space, OpenVPN and nebula.

Settings are those of the packages' own examples: nothing is tuned for or against one. Keys and certificates are made at
the start. The robot is behind an address translation in these examples, so each keeps its way open by itself.
"""

from __future__ import annotations

import os
import subprocess
import textwrap
from abc import abstractmethod
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from namespaces import Namespace
from openssh_server import wait_until

from paper.costs import trees_cpu_s
from paper.peers.transports import STARTS_WITHIN_S, PlainTransport
from paper.programs import Program

# Documentation's own network (RFC 5737): in both namespaces nothing else has it.
NETWORK, PREFIX_LENGTH = "192.0.2.0", 24
SERVER_ADDRESS, ROBOT_ADDRESS = "192.0.2.1", "192.0.2.2"
CONTROL_SOCKETS = Path("/var/run/wireguard")


class Vpn(PlainTransport):
    """A network of the server and the robot, in which both have addresses that stay."""

    # The device at each end.
    device: str
    _server: Program

    def prepare(self, made: ExitStack) -> None:
        self.simulator(made)
        self.make_keys()
        self._server = self.start_server(made)
        made.callback(self._server.end)
        wait_until(
            lambda: self._stands(self.server),
            lambda: f"the server's side of {self.title} stands; it says:\n{self._server.tail()}",
            STARTS_WITHIN_S,
        )

    def _stands(self, namespace: Namespace) -> bool:
        self._server.check()
        done = subprocess.run(
            namespace.command("ip", "-4", "address", "show", "dev", self.device),
            capture_output=True,
            text=True,
            check=False,
        )
        return SERVER_ADDRESS in done.stdout

    @abstractmethod
    def make_keys(self) -> None:
        """Put keys and configuration files into the folder."""

    @abstractmethod
    def start_server(self, made: ExitStack) -> Program:
        """Start the server's side."""

    def robot_address(self) -> str:
        return ROBOT_ADDRESS

    def server_cpu_s(self) -> float:
        return sum(trees_cpu_s([self._server.pid]))

    def put(self, name: str, text: str) -> str:
        path = self.folder / name
        path.touch(0o600)
        path.write_text(textwrap.dedent(text).lstrip())
        return str(path)


class WireGuard(Vpn):
    """WireGuard as wireguard-go has it, set up as wg-quick does, with the keep-alive that its manual names."""

    key, packages = "wireguard", ("wireguard-go", "wireguard-tools")
    PORT, KEEPALIVE_S = 51820, 25

    def make_keys(self) -> None:
        # Its control socket has this name in a directory that all namespaces share.
        self.device = f"wgs{os.getpid()}"
        self._robot_device = f"wgr{os.getpid()}"
        server, robot = (output("wg", "genkey") for _ in range(2))
        there = (
            f"Endpoint = {self.server.address}:{self.PORT}",
            f"PersistentKeepalive = {self.KEEPALIVE_S}",
        )
        lines = [*_interface(server), f"ListenPort = {self.PORT}", *_peer(robot, ROBOT_ADDRESS)]
        self.put(f"{self.device}.conf", "\n".join(lines) + "\n")
        lines = [*_interface(robot), *_peer(server, SERVER_ADDRESS), *there]
        self.put(f"{self._robot_device}.conf", "\n".join(lines) + "\n")

    def start_server(self, made: ExitStack) -> Program:
        return self._start(self.server, self.device, SERVER_ADDRESS)

    def connect(self) -> None:
        self._client = [self._start(self.inside, self._robot_device, ROBOT_ADDRESS)]

    def _start(self, namespace: Namespace, device: str, address: str) -> Program:
        # In one shell, so that the steps after the start take no longer than they do elsewhere.
        script = f"""
            set -e
            wireguard-go --foreground {device} &
            trap 'kill $!; wait $!' TERM
            until [ -S {CONTROL_SOCKETS}/{device}.sock ]; do kill -0 $!; sleep 0.01; done
            wg setconf {device} {self.folder}/{device}.conf
            ip address add {address}/{PREFIX_LENGTH} dev {device}
            ip link set mtu 1420 up dev {device}
            wait $!
            """
        return self.start(namespace, device, "sh", "-c", textwrap.dedent(script))


def _interface(private: str) -> tuple[str, ...]:
    return "[Interface]", f"PrivateKey = {private}"


def _peer(private: str, address: str) -> tuple[str, ...]:
    public = output("wg", "pubkey", given=private)
    return "[Peer]", f"PublicKey = {public}", f"AllowedIPs = {address}/32"


class OpenVpn(Vpn):
    """OpenVPN over UDP as its sample files have it: TLS with certificates, and keep-alives of 10 and 120 s."""

    key, device, packages = "openvpn", "tun0", ("openvpn",)

    def make_keys(self) -> None:
        self._authority()
        for name, use in (("server", "serverAuth"), ("robot", "clientAuth")):
            self._certificate(name, use)
        certificates = f"ca {self.folder}/ca.crt\ncert {{0}}.crt\nkey {{0}}.key\n"
        common = "dev tun\nproto udp4\npersist-key\npersist-tun\nverb 3\n"
        here = f"server {NETWORK} 255.255.255.0\ntopology subnet\nkeepalive 10 120\ndh none\n"
        there = f"client\nremote {self.server.address} 1194\nresolv-retry infinite\nnobind\n"
        there += "remote-cert-tls server\n"
        for name, own in (("server", here), ("robot", there)):
            self.put(f"{name}.conf", common + own + certificates.format(self.folder / name))

    def _authority(self) -> None:
        self._openssl(
            "req", "-x509", "-days", "2", "-subj", "/CN=ca", "-out", "ca.crt", *NEW_KEY, "ca.key"
        )

    def _certificate(self, name: str, use: str) -> None:
        self._openssl("req", "-subj", f"/CN={name}", "-out", f"{name}.csr", *NEW_KEY, f"{name}.key")
        usage = f"extendedKeyUsage = {use}\nkeyUsage = digitalSignature\n"
        extensions = self.put(f"{name}.ext", usage)
        signer = ("-CA", "ca.crt", "-CAkey", "ca.key", "-CAcreateserial", "-days", "2")
        signed = ("-in", f"{name}.csr", "-out", f"{name}.crt", "-extfile", extensions)
        self._openssl("x509", "-req", *signed, *signer)

    def _openssl(self, *words: str) -> None:
        output("openssl", *words, folder=self.folder)

    def start_server(self, made: ExitStack) -> Program:
        return self.start(self.server, "server", *self._command("server"))

    def connect(self) -> None:
        self._client = [self.start(self.inside, "client", *self._command("robot"))]

    def _command(self, name: str) -> Sequence[str]:
        return "openvpn", "--config", str(self.folder / f"{name}.conf")


# Elliptic curves, as easy-rsa's guides advise; to be followed by the key's name.
NEW_KEY = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-keyout")


class Nebula(Vpn):
    """Nebula with its example's settings; the server is the lighthouse."""

    key, device, packages = "nebula", "nebula1", ("nebula",)
    PORT = 4242

    def make_keys(self) -> None:
        output("nebula-cert", "ca", "-name", "experiment", folder=self.folder)
        for name, address in (("server", SERVER_ADDRESS), ("robot", ROBOT_ADDRESS)):
            own = ("-name", name, "-ip", f"{address}/{PREFIX_LENGTH}")
            output("nebula-cert", "sign", *own, folder=self.folder)
        self._setting("server", "{}", "am_lighthouse: true", self.PORT)
        known = f'{{"{SERVER_ADDRESS}": ["{self.server.address}:{self.PORT}"]}}'
        # A robot behind a translation listens anywhere.
        self._setting("robot", known, f'am_lighthouse: false, hosts: ["{SERVER_ADDRESS}"]', 0)

    def _setting(self, name: str, known: str, lighthouse: str, port: int) -> None:
        position = self.folder
        text = f"""
            pki: {{ca: {position}/ca.crt, cert: {position}/{name}.crt, key: {position}/{name}.key}}
            static_host_map: {known}
            lighthouse: {{{lighthouse}, interval: 60}}
            listen: {{host: 0.0.0.0, port: {port}}}
            punchy: {{punch: true}}
            tun: {{dev: {self.device}, drop_local_broadcast: false, drop_multicast: false, tx_queue: 500, mtu: 1300}}
            logging: {{level: info, format: text}}
            firewall:
              outbound: [{{port: any, proto: any, host: any}}]
              inbound: [{{port: any, proto: any, host: any}}]
            """
        self.put(f"{name}.yml", text)

    def start_server(self, made: ExitStack) -> Program:
        return self._start(self.server, "server")

    def connect(self) -> None:
        self._client = [self._start(self.inside, "robot")]

    def _start(self, namespace: Namespace, name: str) -> Program:
        return self.start(
            namespace, f"nebula-{name}", "nebula", "-config", str(self.folder / f"{name}.yml")
        )


def output(*command: str, folder: Path | None = None, given: str | None = None) -> str:
    """What a short command prints, without the line's end."""
    done = subprocess.run(
        command, cwd=folder, input=given, capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise RuntimeError(f"cannot run {' '.join(command)}: {done.stderr}")
    return done.stdout.strip()
