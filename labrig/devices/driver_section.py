"""A section of the rig file whose model belongs to a driver, which its key `driver` names."""

import json
from collections.abc import Hashable
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from typing import TypeVar

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import CoreSchema, PydanticCustomError, SchemaValidator, core_schema

from labrig.errors import InputError, PluginError
from labrig.plugins import find_plugin, find_plugins
from labrig.protocol.model import Conflict, ConflictError, Model
from labrig.protocol.schema import JsonSchema

_KEY = "driver"
_Section = TypeVar("_Section", bound=Model)


def find_section(group: str, name: str, base: type[_Section]) -> type[_Section]:
    """Return the model of the sections with this driver; it has been imported.

    Raises
    ------
    InputError
        When no installed package has one, or several have.
    PluginError
        When its package cannot be imported, is written for another interface, or declares something else.
    """
    plugin = find_plugin(group, name)
    found = plugin.load()
    if not (isinstance(found, type) and issubclass(found, base)):
        raise PluginError(
            f"{plugin} is no section of a rig file, expected a subclass of {base.__name__}",
            f"install another version of {plugin.package}; see {base.__module__}",
        )
    return found


@dataclass(frozen=True)
class DriverSection:
    """Annotates a field of the rig file whose model is that of the driver that the section names.

    Validation imports that driver only; error messages and schemas import every installed driver that can be imported.

    Parameters
    ----------
    group : str
        Entry-point group of the drivers.
    base : type of Model
        What the models of all of them have in common.
    default : str or None
        Driver of a section without the key; None requires the key.
    """

    group: str
    base: type[Model]
    default: str | None = None

    def __get_pydantic_core_schema__(self, _source: object, _handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the schema that validates and serializes a section."""
        written = core_schema.plain_serializer_function_ser_schema(
            lambda section, info: section.model_dump(mode=info.mode), info_arg=True
        )
        return core_schema.no_info_plain_validator_function(self._validate, serialization=written)

    def __get_pydantic_json_schema__(self, _schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchema:
        """Return the schema of a section: one of those of the installed drivers."""
        models: dict[Hashable, CoreSchema] = {}
        for name in find_plugins(self.group):
            with suppress(InputError):
                models[name] = find_section(self.group, name, self.base).__pydantic_core_schema__
        return handler(core_schema.tagged_union_schema(models, _KEY))

    def _validate(self, value: object) -> Model:
        if isinstance(value, self.base):
            return value
        if not isinstance(value, dict):
            raise PydanticCustomError("model_type", "expected a section")
        name = str(value.get(_KEY, self.default))
        try:
            model = find_section(self.group, name, self.base)
        except InputError as error:
            if name not in find_plugins(self.group):
                raise PydanticCustomError("union_tag_invalid", "unknown driver") from error
            raise ConflictError((Conflict(_KEY, error.message, error.hint),)) from error
        made: Model = _make_validator(name, model).validate_json(json.dumps({**value, _KEY: name}))
        return made


@cache
def _make_validator(name: str, model: type[Model]) -> SchemaValidator:
    """Return the validator of the section of a driver; errors name the driver on the path to the key."""
    return SchemaValidator(core_schema.tagged_union_schema({name: model.__pydantic_core_schema__}, _KEY))
