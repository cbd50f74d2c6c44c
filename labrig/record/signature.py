"""Signatures and time stamps of a run: who says that it was so, and when.

A signature is made and verified by `ssh-keygen -Y` in the namespace `labrig`, over the hash of a link as 64 hexadecimal
digits and a newline. It stands in the run, `chain.NNN.sig` for link NNN, and a link of its own covers it. A request for
a time stamp (RFC 3161, DER) goes to any authority; it holds that hash and nothing else, and labrig sends nothing.
"""

import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from labrig.durable import write_atomically
from labrig.errors import InputError, MachineError, Problem
from labrig.record.chain import Link, Time
from labrig.record.layout import COPY_HINT, inside
from labrig.record.seal import read_seal
from labrig.record.sealing import seal_files

NAMESPACE = "labrig"
_TIMEOUT_S = 20.0
# TimeStampReq: version 1; a MessageImprint of SHA-256, 32 bytes; the hash follows, then certReq TRUE.
_REQUEST_HEAD = bytes.fromhex("3039 020101 3031 300d 0609608648016503040201 0500 0420")
_REQUEST_TAIL = bytes.fromhex("0101ff")


@dataclass(frozen=True)
class Signature:
    """A verified signature: the link that it signs, and who signed it."""

    link: int
    signer: str


def sign_run(run: Path, key: Path, at: Time) -> Link:
    """Sign the newest link of a run, and with it everything before; return that link.

    Parameters
    ----------
    key : Path
        Private SSH key, or a public one whose private key the agent holds.

    Raises
    ------
    InputError
        When ssh-keygen cannot sign with the key, or the run has no chain.
    RecordError
        When the chain is damaged.
    """
    newest = _require_newest(run)
    done = _run_ssh_keygen(
        "sign", "-q", "-n", NAMESPACE, "-f", str(key), message=_message(newest), timeout_s=None
    )
    if done.returncode != 0:
        raise InputError(f"cannot sign with {key}: {_last_line(done.stderr)}", "name the file of an SSH key")
    name = _signature_file(newest)
    write_atomically(inside(run, name), done.stdout)
    seal_files(run, "signature", (name,), at)
    return newest


def verify_signatures(run: Path, links: tuple[Link, ...], signers: Path) -> Iterator[Signature | Problem]:
    """Yield each signature of a run, or what is wrong with it.

    Parameters
    ----------
    signers : Path
        The keys that are trusted: an `allowed_signers` file, as `man ssh-keygen` describes it.
    """
    if not signers.is_file():
        raise InputError(f"{signers} is no file", "name a file of allowed signers, see: man ssh-keygen")
    for link in links:
        name = _signature_file(link)
        path = inside(run, name)
        if not path.is_file():
            continue
        found = _run_ssh_keygen("find-principals", "-s", str(path), "-f", str(signers))
        signer = found.stdout.decode(errors="replace").partition("\n")[0]
        options = ("-q", "-n", NAMESPACE, "-s", str(path), "-f", str(signers), "-I", signer)
        if found.returncode != 0 or not signer:
            yield Problem(name, f"no key of {signers} made this signature", "ask who signed it for the key")
        elif _run_ssh_keygen("verify", *options, message=_message(link)).returncode != 0:
            yield Problem(name, f"the signature by {signer} does not fit link {link.number}", COPY_HINT)
        else:
            yield Signature(link.number, signer)


def make_stamp_request(run: Path) -> tuple[Link, bytes]:
    """Return the newest link of a run, and the request for a time stamp of it (RFC 3161, DER).

    Raises
    ------
    InputError
        When the run has no chain.
    RecordError
        When the chain is damaged.
    """
    newest = _require_newest(run)
    return newest, _REQUEST_HEAD + bytes.fromhex(newest.sha256) + _REQUEST_TAIL


def _require_newest(run: Path) -> Link:
    links = read_seal(run).links
    if not links:
        raise InputError(f"{run} has no chain: it was made before runs were sealed")
    return links[-1]


def _signature_file(link: Link) -> str:
    return f"chain.{link.number:03d}.sig"


def _message(link: Link) -> bytes:
    return f"{link.sha256}\n".encode()


def _run_ssh_keygen(
    action: str, *options: str, message: bytes = b"", timeout_s: float | None = _TIMEOUT_S
) -> subprocess.CompletedProcess[bytes]:
    program = shutil.which("ssh-keygen")
    if program is None:
        raise MachineError("ssh-keygen is not installed", "install OpenSSH 8.2 or newer")
    command = [program, "-Y", action, *options]
    try:
        return subprocess.run(command, input=message, capture_output=True, check=False, timeout=timeout_s)  # noqa: S603
    except (OSError, subprocess.TimeoutExpired) as error:
        raise MachineError(f"ssh-keygen gives no answer: {error}") from error


def _last_line(text: bytes) -> str:
    return (text.decode(errors="replace").strip().splitlines() or ["it says nothing"])[-1]
