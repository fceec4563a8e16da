"""What the extra ``serve`` brings."""

from importlib import import_module
from types import ModuleType

from lemma.core.errors import InvalidConfigError


def websockets(module: str) -> ModuleType:
    """Import a module of the package websockets.

    Args:
        module: Such as ``"sync.client"``.

    Raises:
        InvalidConfigError: The package is not installed.
    """
    try:
        return import_module(f"websockets.{module}")
    except ImportError as error:
        raise InvalidConfigError(
            "The package websockets is not installed, without which policies cannot be "
            "reached over a socket. Install it with: pip install 'lemma-bench[serve]'"
        ) from error
