"""The JSON Schemas of the files that people write, with the experiments, drives and cameras of installed packages."""

from typing import Any, Literal

FileKind = Literal["protocol", "rig", "specimen", "campaign"]


def make_schema(of: FileKind) -> dict[str, Any]:
    """Return the schema of a kind of file."""
    if of == "protocol":
        from labrig.experiments.declared import list_usable_models
        from labrig.protocol.load import protocol_schema

        return protocol_schema(list_usable_models())
    if of == "rig":
        from labrig.devices.rig_file import rig_schema

        return rig_schema()
    if of == "campaign":
        from labrig.campaign.campaign_file import campaign_schema

        return campaign_schema()
    from labrig.protocol.specimen_file import specimen_schema

    return specimen_schema()
