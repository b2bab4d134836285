"""Checks signatures that `ssh-keygen -Y sign` made (OpenSSH's PROTOCOL.sshsig), by asking ssh-keygen.

Used by joins, for a robot that proves with its old key that the new one is its own. OpenSSH reads its own
format; the library `cryptography` does not know it. Must never be given a key that did not pass ssh_keys.py.
"""

import logging
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

from robotether_server.ssh_keys import PublicKey

logger = logging.getLogger(__name__)

MAX_SIGNATURE_LENGTH = 4096
SIGNER = "robot"
TIMEOUT_S = 5


def holds(key: PublicKey, namespace: str, message: str, signature: str) -> bool:
    """Tell whether the signature over the message was made with that key, for that namespace.

    Raises OSError when there is no ssh-keygen, and subprocess.TimeoutExpired.
    """
    with TemporaryDirectory(prefix="robotether-") as folder:
        signers, file = Path(folder, "signers"), Path(folder, "signature")
        signers.write_text(f'{SIGNER} namespaces="{namespace}" {key.line}\n', encoding="ascii")
        file.write_text(signature, encoding="utf-8")
        signer = ("-f", str(signers), "-I", SIGNER, "-n", namespace)
        done = subprocess.run(  # noqa: S603 - fixed words, and paths of ours
            ["ssh-keygen", "-Y", "verify", *signer, "-s", str(file)],  # noqa: S607 - PATH is the image's
            input=message.encode(),
            capture_output=True,
            check=False,
            timeout=TIMEOUT_S,
        )
    if done.returncode != 0:
        logger.info("signature of key %s refused: %r", key.fingerprint, done.stderr[-200:])
    return done.returncode == 0
