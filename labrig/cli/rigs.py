"""Which rig a protocol runs on, if it needs one."""

from collections.abc import Sequence
from pathlib import Path

from labrig.cli.options import rig_file, rig_settings_as_typed
from labrig.cli.output import say
from labrig.devices import RigDescription, load_rig
from labrig.errors import InputError
from labrig.protocol import AnyProtocol, DesignProtocol, SteerabilityProtocol


def remark_on_yes(description: RigDescription, *, yes: bool) -> None:
    """Say that `--yes` does not answer where a person must."""
    if yes and description.kind != "simulated":
        say("note: --yes does not answer on a real rig; every question is asked")


def rig_for(
    protocol: AnyProtocol, protocol_file: Path, given: Path | None, overrides: Sequence[str]
) -> RigDescription | None:
    """Return the rig that the protocol runs on; None, and no file read, for a design.

    It is as its file describes it; a simulated world has the needle of the protocol's design file in it.

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
        With every fault of the rig file, or when the simulated world has no room for the protocol's needle.
    """
    if isinstance(protocol, DesignProtocol):
        if given is not None or overrides:
            raise InputError("a design moves no rig", "leave out --rig and --set rig.*")
        return None
    with rig_settings_as_typed():
        rig = load_rig(rig_file(given, protocol_file), overrides)
    return rig.with_needle(protocol.needle) if isinstance(protocol, SteerabilityProtocol) else rig
