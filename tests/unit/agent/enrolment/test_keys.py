"""The robot's own key, made by the real ssh-keygen, and the pin of the server's host keys."""

import asyncio
import subprocess
from pathlib import Path

import pytest
from robotether_agent.enrolment import keys
from robotether_agent.enrolment.enroller import Enrolment, EnrolmentStore
from robotether_agent.enrolment.join import SshAccess
from robotether_agent.enrolment.keys import (
    ALIAS,
    HostKey,
    check_host_keys,
    ensure_key,
    ensure_next_key,
    next_key,
    pinned_host_keys,
    promote,
)
from robotether_agent.problems import (
    KeyUnusableError,
    ServerKeyChangedError,
    SshMissingError,
    StateUnusableError,
)


async def test_open_mode_and_missing_public_half_are_mended(place):
    first = await ensure_key(place)
    first.path.chmod(0o644)
    (place / "id_ed25519.pub").unlink()
    assert await ensure_key(place) == first
    assert first.path.stat().st_mode & 0o777 == 0o600


async def test_broken_and_foreign_keys_are_told(place):
    (place / "id_ed25519").write_text("rubbish")
    with pytest.raises(KeyUnusableError, match="id_ed25519") as damaged:
        await ensure_key(place)
    assert "remove it" in damaged.value.advice
    (place / "id_ed25519").unlink()
    command = ["ssh-keygen", "-q", "-t", "ecdsa", "-N", "", "-f", str(place / "id_ed25519")]
    await asyncio.to_thread(subprocess.run, command, check=True, stdin=subprocess.DEVNULL)
    with pytest.raises(KeyUnusableError, match="not ssh-ed25519"):
        await ensure_key(place)


async def test_without_ssh_keygen(place, monkeypatch):
    monkeypatch.setenv("PATH", str(place))
    with pytest.raises(SshMissingError, match="openssh-client"):
        await ensure_key(place)
    assert list(place.iterdir()) == []


async def test_two_processes_make_one_key(place):
    made = await asyncio.gather(*(ensure_key(place) for _ in range(4)))
    assert len({key.public for key in made}) == 1
    assert await ensure_key(place) == made[0]
    # The public half may be missing, as it can be told from the private one.
    assert {path.name for path in place.iterdir()} <= {"id_ed25519", "id_ed25519.pub"}


@pytest.mark.parametrize("steps", range(4))
async def test_a_change_that_is_cut_short_leaves_whole_keys(place, monkeypatch, steps):
    """Whichever step of it is the last before the power goes, no key is lost and none has another's half."""
    old, coming = await ensure_key(place), await ensure_next_key(place)
    left = iter(range(steps))

    def cut(real):
        def step(*arguments, **options):
            if next(left, None) is None:
                raise PowerCutError
            return real(*arguments, **options)

        return step

    with monkeypatch.context() as patch:
        patch.setattr("pathlib.Path.unlink", cut(Path.unlink))
        patch.setattr("pathlib.Path.replace", cut(Path.replace))
        patch.setattr("robotether_agent.enrolment.keys.sync", cut(keys.sync))
        with pytest.raises(PowerCutError):
            await promote(place)
    now, after = await ensure_key(place), await next_key(place)
    assert coming.public in {now.public, after and after.public}
    assert now.public in {old.public, coming.public}
    for key in filter(None, (now, after)):
        command = ["ssh-keygen", "-y", "-f", str(key.path)]
        said = await asyncio.to_thread(subprocess.run, command, check=True, capture_output=True)
        assert said.stdout.decode().startswith(key.public)
    await promote(place)
    assert (await ensure_key(place)).public == coming.public


class PowerCutError(Exception):
    """The robot lost its power."""


async def test_a_broken_next_key_does_not_touch_the_key_in_use(place):
    (place / "id_ed25519.next").write_text("rubbish")
    (place / "id_ed25519.next").chmod(0o600)
    assert await next_key(place) is None
    with pytest.raises(KeyUnusableError, match=r"id_ed25519\.next"):
        await ensure_next_key(place)


ED = HostKey("ssh-ed25519", "RUQx")
ED_OTHER = HostKey("ssh-ed25519", "RUQy")
RSA = HostKey("ssh-rsa", "UlNB")
PATH = Path("/state/known_hosts")
ACCESS = SshAccess("tunnel", None, (2222, 443))
ENROLMENT = Enrolment("a.example", "sim1", "00:1b:44:11:3a:b7", ACCESS)
BLOB = "AAAAC3NzaC1lZDI1NTE5AAAAIJXwzyV7Yl1cYqPGRkvnkSnMuRlWZ2EiJkXYh2JYQ0bF"
PINNED = HostKey("ssh-ed25519", BLOB)
OTHER = HostKey("ssh-ed25519", BLOB[:-2] + "aA")


@pytest.mark.parametrize(
    ("now", "trusted"),
    [
        ([ED], True),
        ([ED, RSA], True),
        ([ED_OTHER], False),
        ([ED_OTHER, RSA], False),
        ([ED, ED_OTHER], False),
        ([RSA], False),
    ],
)
def test_only_what_agrees_with_the_pin_is_trusted(now, trusted):
    """A changed key is an alarm, a key of a new type is none, and nothing in common is one."""
    if trusted:
        check_host_keys(PATH, [ED], now)
        return
    with pytest.raises(ServerKeyChangedError, match="SHA256:"):
        check_host_keys(PATH, [ED], now)


@pytest.mark.parametrize("text", ["", f"{ALIAS} ssh-ed25519 %%%\n", "someone ssh-ed25519 RUQx\n"])
def test_a_broken_pin_is_not_as_good_as_none(place, text):
    """A damaged file must not make the agent trust whatever comes next."""
    (place / "known_hosts").write_text(text)
    with pytest.raises(StateUnusableError, match="cannot use the pinned host keys"):
        pinned_host_keys(place / "known_hosts")


@pytest.mark.parametrize("broken", [b"{", b"\0" * 99, b"\xff{"])
def test_a_broken_enrolment_keeps_the_pin(place, broken):
    """Losing the enrolment means to join again, not to trust anew."""
    store = EnrolmentStore(place)
    store.keep(ENROLMENT, [PINNED])
    (place / "enrolment.json").write_bytes(broken)
    assert store.load("a.example") is None
    with pytest.raises(ServerKeyChangedError):
        store.keep(ENROLMENT, [OTHER])


def test_removing_known_hosts_joins_anew(place):
    store = EnrolmentStore(place)
    store.keep(ENROLMENT, [PINNED])
    store.known_hosts.unlink()
    assert store.load("a.example") is None
    store.keep(ENROLMENT, [OTHER])
    assert store.load("a.example") == ENROLMENT
