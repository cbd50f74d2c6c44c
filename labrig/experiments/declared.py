"""The declarations of installed experiments, read without importing a procedure, an analysis or a page."""

import importlib
import symtable
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from typing import Any

from labrig.errors import InputError, PluginError
from labrig.experiments.declaration import PARTS, ExperimentDeclaration
from labrig.plugins import EXPERIMENTS, Plugin, find_plugin, find_plugins
from labrig.protocol.sections import ExperimentProtocol

_WITHOUT_OTHERS = "it moves no rig, or ends as it is"
_WITHOUT = {"values": "each run of it takes a whole simulated rig, with camera, bus and record"}


@dataclass(frozen=True)
class DeclaredExperiment:
    """An experiment of an installed package: its declaration, and its parts by name."""

    plugin: Plugin
    declaration: ExperimentDeclaration

    @property
    def name(self) -> str:
        """The value of `experiment:` in a protocol file."""
        return self.declaration.name

    @property
    def protocol_model(self) -> type[ExperimentProtocol]:
        """The model of its protocol."""
        model: type[ExperimentProtocol] = self.part("protocol")
        return model

    def part(self, name: str) -> Any:
        """Import a part; refuse a part that is not declared, or that does not exist."""
        where = getattr(self.declaration, name)
        if where is None:
            raise InputError(f"the experiment {self.name} has no {name}", _WITHOUT.get(name, _WITHOUT_OTHERS))
        module, _, attribute = where.partition(":")
        try:
            return getattr(importlib.import_module(module), attribute)
        except Exception as error:
            raise PluginError(
                f"{self.plugin}: its {name} is not at {where}: {type(error).__name__}: {error}",
                f"install another version of {self.plugin.package}",
            ) from error

    def require_parts(self) -> None:
        """Refuse a declaration with a part that does not exist, before anything moves.

        The source of a module is read; it is imported only if that is inconclusive, so that no page is imported early.

        Raises
        ------
        PluginError
            Names the part.
        """
        for name in PARTS:
            where = getattr(self.declaration, name)
            if where is not None and not _is_defined(where):
                self.part(name)


def _is_defined(where: str) -> bool:
    """Return whether the source of a module defines a name."""
    module, _, attribute = where.partition(":")
    try:
        spec = find_spec(module)
        source = getattr(spec.loader, "get_source", lambda _: None)(module) if spec is not None else None
        table = symtable.symtable(source or "", module, "exec")
    except (ImportError, SyntaxError):
        return False
    if attribute not in table.get_identifiers():
        return False
    symbol = table.lookup(attribute)
    return symbol.is_assigned() or symbol.is_imported()


@cache
def find_declared(name: str) -> DeclaredExperiment:
    """Return the experiment of this name.

    Raises
    ------
    InputError
        When no installed package has it, or several have.
    PluginError
        When its declaration cannot be imported or is not one.
    MachineError
        When labrig's own experiments are missing.
    """
    plugin = find_plugin(EXPERIMENTS, name)
    declaration = plugin.load()
    if not isinstance(declaration, ExperimentDeclaration) or declaration.name != name:
        raise PluginError(
            f"{plugin} is declared by {declaration!r}, expected an ExperimentDeclaration of the same name",
            f"install another version of {plugin.package}",
        )
    return DeclaredExperiment(plugin, declaration)


class ProtocolModels(Mapping[str, type[ExperimentProtocol]]):
    """The model of each experiment's protocol, imported on first use."""

    def __getitem__(self, name: str) -> type[ExperimentProtocol]:
        if name not in find_plugins(EXPERIMENTS):
            raise KeyError(name)
        return find_declared(name).protocol_model

    def __iter__(self) -> Iterator[str]:
        return iter(find_plugins(EXPERIMENTS))

    def __len__(self) -> int:
        return len(find_plugins(EXPERIMENTS))

    def __contains__(self, name: object) -> bool:
        return name in find_plugins(EXPERIMENTS)


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
