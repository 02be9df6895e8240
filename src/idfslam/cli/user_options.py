"""`--help` shows the options that users set; `--help-all` shows all of them.

Which values of the configuration users set is marked on their fields (`UserOption` in config/). Flags that are no part of the
configuration are always shown. Hidden options work as all others do.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from typing import Annotated, Any

import tyro
from tyro.conf import Suppress, arg
from tyro.constructors import ConstructorRegistry, StructConstructorSpec, StructFieldSpec, StructTypeInfo

from idfslam import config
from idfslam.config.fields import field_types, is_user_option, meanings

HELP, HELP_ALL = ("-h", "--help"), "--help-all"


def parser_rules(arguments: Sequence[str]) -> ConstructorRegistry:
    """Rules for tyro's parser where `arguments` ask for help: each field's docstring as one paragraph, and what the short help hides."""
    registry = ConstructorRegistry()
    if HELP_ALL in arguments:
        registry.struct_rule(_with_help)
    elif any(flag in arguments for flag in HELP):
        registry.struct_rule(lambda info: _with_help(info, hide=True))
    return registry


def _with_help(info: StructTypeInfo, *, hide: bool = False) -> StructConstructorSpec | None:
    """A dataclass of this package with the help of its fields; None for all other types.

    hide: fields of the configuration that are no user options are left out of the help.
    """
    kind = info.type
    if not (isinstance(kind, type) and is_dataclass(kind) and kind.__module__.startswith("idfslam.")):
        return None
    types, texts = field_types(kind), meanings(kind)
    specs = []
    for field in fields(kind):
        field_type: Any = types[field.name]
        default = _default(field, info.default)
        hidden = hide and kind.__module__.startswith(f"{config.__name__}.") and not is_dataclass(default) and not is_user_option(field_type)
        if hidden:
            field_type = Annotated[field_type, Suppress]
        text = texts.get(field.name)
        if default in (None, ()) and text is not None:  # the text says what happens then
            field_type = Annotated[field_type, arg(help_behavior_hint="")]
        specs.append(StructFieldSpec(field.name, field_type, default, text))
    return StructConstructorSpec(kind, tuple(specs))


def _default(field: dataclasses.Field[Any], parent: Any) -> Any:
    """A field's value in `parent`, an instance of its dataclass; without one, the default of the dataclass."""
    if hasattr(parent, field.name):
        return getattr(parent, field.name)
    if field.default is not dataclasses.MISSING:
        return field.default
    return tyro.MISSING_NONPROP if field.default_factory is dataclasses.MISSING else field.default_factory()
