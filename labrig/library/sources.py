"""The files that a run is made from: their names are kept in its manifest and used again when it is continued."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

from labrig.devices.rig_file import RigDescription, load_rig
from labrig.errors import FileFormatError, InputError
from labrig.experiments.declared import PROTOCOL_MODELS, find_experiment
from labrig.lab import find_lab_folder
from labrig.library.names import find_protocol_file, find_rig_file
from labrig.protocol.load import load_protocol
from labrig.protocol.sections import ExperimentProtocol, Needle
from labrig.record.json_lines import plain_text

_RIG_PREFIX = "rig."


@dataclass(frozen=True)
class Sources:
    """Protocol file, rig file if one was named, overrides and seed."""

    protocol: Path
    rig: Path | None
    settings: tuple[str, ...]
    seed: int | None

    @classmethod
    def of(
        cls, protocol: Path | str, rig: Path | str | None, settings: Sequence[str], seed: int | None
    ) -> Self:
        """Return the sources that are named: a protocol by its file, or its name in the lab folder."""
        file = find_protocol_file(Path(protocol), is_campaign=False)
        return cls(file, None if rig is None else Path(rig), tuple(settings), seed)

    def load(self) -> tuple[ExperimentProtocol, RigDescription | None]:
        """Read protocol and rig, as `labrig run` does. Raises `FileFormatError`, `InputError`."""
        of_protocol, of_rig = split_overrides(self.settings)
        protocol = load_protocol(self.protocol, PROTOCOL_MODELS, of_protocol, self.seed)
        return protocol, fit_rig(protocol, load_rig_for(protocol, self.protocol, self.rig, of_rig))

    def document(self, *, has_rig: bool) -> dict[str, object]:
        """Return the form for the manifest; relative names are relative to the lab folder."""
        rig = find_rig_file(self.rig, self.protocol) if has_rig else None
        return {
            "protocol": plain_text(str(_place_in_lab(self.protocol))),
            "rig": None if rig is None else plain_text(str(_place_in_lab(rig))),
            "settings": list(self.settings),
            "seed": self.seed,
        }


def _place_in_lab(path: Path) -> Path:
    """Return a relative name of a file in the lab folder as one that is relative to that; any other as typed."""
    lab = find_lab_folder()
    if path.is_absolute() or lab is None:
        return path
    placed = Path(os.path.relpath(path, lab))
    return path if ".." in placed.parts else placed


def find_recorded_rig(run: Path, manifest: Mapping[str, Any]) -> tuple[Path | None, list[str]]:
    """Return the rig file that a run was started with, None if it names none, and what was set of it.

    A file that is not below the working folder is that of the lab folder that holds the run.
    """
    kept = manifest.get("sources") or {}
    settings = split_overrides([str(setting) for setting in kept.get("settings", ())])[1]
    if kept.get("rig") is None:
        return None, settings
    path, lab = Path(str(kept["rig"])), find_lab_folder(run)
    if lab is not None and not path.exists() and (lab / path).exists():
        path = lab / path
    return path, settings


def load_rig_for(
    protocol: ExperimentProtocol, protocol_file: Path, given: Path | None, overrides: Sequence[str]
) -> RigDescription | None:
    """Return the rig that the protocol runs on; None for an experiment without a rig, for which no file is read.

    Parameters
    ----------
    given : Path or None
        The rig file that was named, if any.
    overrides : sequence of str
        `dotted.key=value` for the rig file.

    Raises
    ------
    InputError
        When there is no rig file, or one is given for a protocol that moves nothing.
    FileFormatError
        With every problem of the rig file.
    """
    experiment = find_experiment(protocol.experiment)
    if not experiment.moves_rig:
        if given is not None or overrides:
            raise InputError(
                f"the experiment {experiment.name} moves no rig", "leave out --rig and --set rig.*"
            )
        return None
    try:
        return load_rig(find_rig_file(given, protocol_file), overrides)
    except FileFormatError as error:
        typed = (
            replace(problem, where=problem.where.replace("--set ", f"--set {_RIG_PREFIX}", 1))
            for problem in error.problems
        )
        raise FileFormatError(tuple(typed)) from error


def fit_rig(protocol: ExperimentProtocol, rig: RigDescription | None) -> RigDescription | None:
    """Return a rig whose simulated world has the needle of the protocol's design file.

    Raises
    ------
    FileFormatError
        When the world has no room for it.
    """
    needle = getattr(protocol, "needle", None)
    return rig if rig is None or not isinstance(needle, Needle) else rig.with_needle(needle)


def split_overrides(settings: Sequence[str]) -> tuple[list[str], list[str]]:
    """Split `--set` values into those of the protocol and those of the rig file, without the prefix `rig.`."""
    rig = [setting.removeprefix(_RIG_PREFIX) for setting in settings if setting.startswith(_RIG_PREFIX)]
    return [setting for setting in settings if not setting.startswith(_RIG_PREFIX)], rig
