"""Protocols that a test holds as text."""

from pathlib import Path
from tempfile import TemporaryDirectory

from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.protocol.load import load_protocol
from labrig.protocol.sections import ExperimentProtocol


def load_text(text: str) -> ExperimentProtocol:
    """Load a protocol from a file that is removed afterwards."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "protocol.yaml"
        path.write_text(text, encoding="utf-8")
        return load_protocol(path, PROTOCOL_MODELS)
