"""Which rig a protocol runs on, if it needs one."""

from collections.abc import Sequence
from pathlib import Path

from labrig.cli.options import rig_file
from labrig.devices import RigDescription, load_rig
from labrig.errors import InputError
from labrig.protocol import AnyProtocol, DesignProtocol


def rig_for(
    protocol: AnyProtocol, protocol_file: Path, given: Path | None, overrides: Sequence[str]
) -> RigDescription | None:
    """Return the rig that the protocol runs on, as its file describes it; None, and no file read, for a design.

    Parameters
    ----------
    given : Path or None
        The rig file that was named, if one was.
    overrides : sequence of str
        `dotted.key=value` for the rig file.

    Raises
    ------
    InputError
        When there is no rig file, or one is given to a protocol that moves nothing.
    FileFormatError
        With every fault of the rig file.
    """
    if isinstance(protocol, DesignProtocol):
        if given is not None or overrides:
            raise InputError("a design moves no rig", "leave out --rig and --set rig.*")
        return None
    return load_rig(rig_file(given, protocol_file), overrides)
