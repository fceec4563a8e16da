"""Classes by path, ``"package.module:Class"``, or by the short names for LeRobot."""

import json
import re
from collections.abc import Iterable, Mapping
from typing import Any

from lemma.core.errors import InvalidConfigError
from lemma.core.plugins import import_from_here

LEROBOT = "lerobot:"
"""Prefix of the name of a LeRobot checkpoint, ``"lerobot:CHECKPOINT"``."""
LEROBOT_PRIVILEGED = "lerobot-privileged:"
"""Prefix for a checkpoint that gets the simulation's state, an oracle."""
_SECRET = re.compile(
    r"(?i)((api|access|auth|private|secret)[_-]?key|token|secret|passw(or)?d|passphrase|"
    r"credentials?|authorization|bearer)$"
)
_MODULE = "lemma.policies.control.lerobot"
_LEROBOT_CLASSES = {
    LEROBOT: f"{_MODULE}:LeRobotPolicy",
    LEROBOT_PRIVILEGED: f"{_MODULE}:PrivilegedLeRobotPolicy",
}


def checkpoint_of(name: str) -> str | None:
    """Return the LeRobot checkpoint in a policy's name; None if there is none."""
    for prefix in _LEROBOT_CLASSES:
        if name.startswith(prefix):
            return name.removeprefix(prefix)
    return None


def privileged(name: str) -> bool:
    """Return whether a policy's name is that of a privileged LeRobot checkpoint."""
    return name.startswith(LEROBOT_PRIVILEGED)


def class_of(name: str) -> Any:
    """Import a class or another factory.

    Args:
        name: ``"package.module:Class"``, or ``"lerobot:CHECKPOINT"``.

    Raises:
        InvalidConfigError: There is no such class.
    """
    begin, colon, _ = name.partition(":")
    path = _LEROBOT_CLASSES.get(f"{begin}{colon}", name)
    module, _, attribute = path.partition(":")
    try:
        return getattr(import_from_here(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        valid = "Name a class of a module that can be imported, from an installed "
        valid += "package or this folder, as in mypackage.mymodule:MyPolicy."
        if path != name:
            valid = "It needs the lerobot package: pip install 'lemma-bench[lerobot]', "
            valid += "in an environment with Python 3.12 or newer."
        raise InvalidConfigError(f"There is no {name}: {error}. {valid}") from error


def instance_of(name: str, arguments: Mapping[str, Any] | None = None) -> Any:
    """Instantiate a class.

    Args:
        name: ``"package.module:Class"``, or ``"lerobot:CHECKPOINT"``.
        arguments: Arguments of the class, by name.

    Raises:
        InvalidConfigError: There is no such class, or its constructor fails.
    """
    check_no_secret(arguments or ())
    make = class_of(name)
    checkpoint = checkpoint_of(name)
    if checkpoint is not None:
        arguments = {"checkpoint": checkpoint, **(arguments or {})}
    try:
        return make(**(arguments or {}))
    except Exception as error:
        shown = ", ".join(
            f"{key}={value!r}" for key, value in (arguments or {}).items()
        )
        raise InvalidConfigError(
            f"{name} could not be made: {type(error).__name__}: {error}. It is called "
            f"with {shown or 'no arguments'}."
        ) from error


def secret_in(text: str) -> str | None:
    """Return the name of the first field of valid JSON that looks like a secret."""
    found: list[str] = []
    json.loads(
        text, object_hook=lambda data: found.extend(filter(_SECRET.search, data))
    )
    return found[0] if found else None


def check_no_secret(names: Iterable[str]) -> None:
    """Check that no argument's name looks like a secret; results list all arguments.

    Args:
        names: Names of the arguments.

    Raises:
        InvalidConfigError: A name looks like a secret.
    """
    for name in names:
        if _SECRET.search(name):
            raise InvalidConfigError(
                f"The argument {name!r} looks like a secret, and results hold the "
                "arguments of a policy. Have the policy read it from an environment "
                "variable or a file."
            )
