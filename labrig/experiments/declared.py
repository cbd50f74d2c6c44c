"""Finds installed experiments by name, and the models of their protocols."""

from collections.abc import Iterator, Mapping
from functools import cache

from labrig.errors import InputError, PluginError
from labrig.plugins import EXPERIMENTS, find_plugin, find_plugins
from labrig.protocol.sections import ExperimentProtocol
from labrig.runner.experiment import Experiment


@cache
def find_experiment(name: str) -> Experiment:
    """Return the experiment of this name.

    Raises
    ------
    InputError
        When no installed package has it, or several have.
    PluginError
        When it cannot be imported or is none.
    MachineError
        When labrig's own experiments are missing.
    """
    plugin = find_plugin(EXPERIMENTS, name)
    found = plugin.load()
    if not isinstance(found, Experiment) or found.name != name:
        raise PluginError(
            f"{plugin} is declared by {found!r}, expected an Experiment of the same name",
            f"install another version of {plugin.package}",
        )
    return found


class ProtocolModels(Mapping[str, type[ExperimentProtocol]]):
    """The model of each experiment's protocol, imported on first use."""

    def __getitem__(self, name: str) -> type[ExperimentProtocol]:
        if name not in find_plugins(EXPERIMENTS):
            raise KeyError(name)
        return find_experiment(name).protocol_model

    def __iter__(self) -> Iterator[str]:
        return iter(find_plugins(EXPERIMENTS))

    def __len__(self) -> int:
        return len(find_plugins(EXPERIMENTS))


PROTOCOL_MODELS = ProtocolModels()
"""Of every experiment that is installed."""


def list_usable_models() -> dict[str, type[ExperimentProtocol]]:
    """Return the model of each installed experiment that can be imported and that only one package claims."""
    models = {}
    for name in PROTOCOL_MODELS:
        try:
            models[name] = PROTOCOL_MODELS[name]
        except InputError:
            continue
    return models
