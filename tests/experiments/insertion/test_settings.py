"""The settings of the steering step from a protocol."""

from pathlib import Path

import pytest

from labrig.errors import FileFormatError
from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.experiments.insertion.protocol import InsertionProtocol
from labrig.experiments.insertion.settings import make_insertion_settings
from labrig.protocol.load import load_protocol
from labrig.protocol.yaml_file import dump_yaml
from labrig.steering.parameters import PAPER_POLICY
from tests.runner.sessions import PROTOCOLS


def load(*overrides: str) -> InsertionProtocol:
    """Return the example protocol with these overrides."""
    protocol = load_protocol(PROTOCOLS / "insertion.yaml", PROTOCOL_MODELS, overrides)
    assert isinstance(protocol, InsertionProtocol)
    return protocol


def test_one_word_is_the_whole_of_the_papers_policy(tmp_path: Path) -> None:
    """The paper's planner and filter, no limit of the angle, and a file with every key says the same."""
    protocol = load("policy=paper")
    settings = make_insertion_settings(protocol, (0.0, 4.0, 100.0), ())
    assert settings.policy == PAPER_POLICY
    assert (settings.method, settings.estimator.method, protocol.policy.turning) == (
        "paper",
        "paper",
        "back_and_forth",
    )
    path = tmp_path / "resolved.yaml"
    path.write_text(dump_yaml(protocol), encoding="utf-8")
    assert load_protocol(path, PROTOCOL_MODELS) == protocol


@pytest.mark.parametrize(
    "beside",
    [
        "planner.method=best", "estimator.method=error-state", "estimator.radius_sd_mm=0",
        "estimator.cavity_every_mm=50", "estimator.slip_sd=0.01", "policy.near_mm=0",
    ],
)  # fmt: skip
def test_a_key_beside_the_papers_policy_is_refused(beside: str) -> None:
    """What the word decides cannot be set too."""
    with pytest.raises(FileFormatError, match=beside.partition("=")[0]):
        load("policy=paper", beside)
