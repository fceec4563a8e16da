"""Classes by path: ``"package.module:Class"``."""

from collections.abc import Mapping
from importlib import import_module
from typing import Any

from lemma.core.errors import InvalidConfigError


def class_of(name: str) -> Any:
    """Return a class, or whatever else makes an object when it is called.

    Args:
        name: ``"package.module:Class"``.

    Raises:
        InvalidConfigError: There is no such class.
    """
    module, _, attribute = name.partition(":")
    try:
        return getattr(import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise InvalidConfigError(
            f"There is no {name}: {error}. Name a class of a module that can be "
            "imported here, as in mypackage.mymodule:MyPolicy."
        ) from error


def instance_of(name: str, arguments: Mapping[str, Any] | None = None) -> Any:
    """Return an object of a class.

    Args:
        name: ``"package.module:Class"``.
        arguments: That it is called with, by name.

    Raises:
        InvalidConfigError: There is no such class, or it cannot be made.
    """
    make = class_of(name)
    try:
        return make(**(arguments or {}))
    except Exception as error:
        raise InvalidConfigError(
            f"{name} could not be made: {type(error).__name__}: {error}. It is called "
            f"{_with(arguments)}."
        ) from error


def _with(arguments: Mapping[str, Any] | None) -> str:
    if not arguments:
        return "without arguments"
    return "with " + ", ".join(f"{name}={value!r}" for name, value in arguments.items())
