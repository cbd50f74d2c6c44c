"""The files that a run is made from: their names are kept in its manifest and used again when it is continued."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from labrig.cli.options import find_rig_file, split_overrides
from labrig.cli.rigs import load_rig_for
from labrig.devices.rig_file import RigDescription
from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.experiments.registry import find_experiment
from labrig.protocol.formatting import mask_passwords
from labrig.protocol.load import load_protocol
from labrig.protocol.sections import ExperimentProtocol


@dataclass(frozen=True)
class Sources:
    """Protocol file, rig file if one was named, overrides and seed."""

    protocol: Path
    rig: Path | None
    settings: tuple[str, ...]
    seed: int | None

    def load(self) -> tuple[ExperimentProtocol, RigDescription | None]:
        """Read protocol and rig, as `labrig run` does. Raises `FileFormatError`, `InputError`."""
        protocol_settings, rig_settings = split_overrides(self.settings)
        protocol = load_protocol(self.protocol, PROTOCOL_MODELS, protocol_settings, self.seed)
        return protocol, load_rig_for(protocol, self.protocol, self.rig, rig_settings)

    def with_rig_file(self, protocol: ExperimentProtocol) -> "Sources":
        """Return these with the default rig file, if none was named and the protocol needs one."""
        if not find_experiment(protocol.experiment).moves_rig:
            return self
        return Sources(self.protocol, find_rig_file(self.rig, self.protocol), self.settings, self.seed)

    def document(self) -> dict[str, object]:
        """Return the form for the manifest: names as typed, without folders of this computer and passwords."""
        rig = None if self.rig is None else str(self.rig)
        return {
            "protocol": str(self.protocol),
            "rig": rig,
            "settings": list(map(mask_passwords, self.settings)),
            "seed": self.seed,
        }


def read_sources(manifest: Mapping[str, object]) -> Sources | None:
    """Return the sources in the manifest of a run; None for the run of an older labrig, which kept none."""
    kept = manifest.get("sources")
    if not isinstance(kept, Mapping):
        return None
    rig, seed, settings = kept.get("rig"), kept.get("seed"), kept.get("settings")
    return Sources(
        Path(str(kept.get("protocol"))),
        None if rig is None else Path(str(rig)),
        tuple(map(str, settings)) if isinstance(settings, list) else (),
        seed if isinstance(seed, int) else None,
    )
