"""Plugins: modules of users that register tasks, arms, primitives and other records.

A plugin adds records to registries when it is imported. An environment variable passes
its name to worker processes, which import it as well.
"""

import json
import os
import re
import sys
import traceback
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import cache, partial
from hashlib import sha256
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

from lemma.core.errors import PluginError

ENVIRONMENT = "LEMMA_PLUGINS"
"""Environment variable with names of plugins, separated by commas or as a JSON list."""
GROUP = "lemma.plugins"
"""Group of entry points of installed distributions; each value is a plugin's module."""

_loaded: dict[str, ModuleType] = {}


def load_plugins(names: Iterable[str] = ()) -> tuple[str, ...]:
    """Import plugins once: installed ones, those of the environment, and named ones.

    The environment variable then names all of them, for processes that start later.

    Args:
        names: Importable modules, such as ``"my_package.tasks"``, or files, such as
            ``"my_task.py"``.

    Returns:
        All loaded plugins: modules by name, files by absolute path.

    Raises:
        PluginError: A plugin cannot be imported; the message has its name and the
            reason.
    """
    for entry in _installed():
        _load(entry.value, entry.load, f"{entry.value} of {_owner(entry.dist)}")
    for name in (*split_names(os.environ.get(ENVIRONMENT, "")), *names):
        if name.endswith(".py"):
            path = Path(name).absolute()
            _load(str(path), partial(_import_file, path), name)
        else:
            _load(name, partial(_import_plugin, name), name)
    if _loaded:
        listed = any("," in name for name in _loaded)
        os.environ[ENVIRONMENT] = (json.dumps if listed else ",".join)([*_loaded])
    return tuple(_loaded)


def plugin_words() -> list[str]:
    """Return the command-line arguments that load the same plugins, files by name.

    Installed plugins need no argument.
    """
    installed = {entry.value for entry in _installed()}
    names = [name for name in _loaded if name not in installed]
    return [
        word
        for name in names
        for word in ("--plugin", Path(name).name if name.endswith(".py") else name)
    ]


@cache
def _installed() -> tuple[EntryPoint, ...]:
    return tuple(entry_points(group=GROUP))


def split_names(listed: str) -> list[str]:
    """Split a list of names.

    Args:
        listed: Names separated by commas, a JSON list, or the path of one file.
    """
    if os.path.isfile(listed):
        return [listed]
    with suppress(ValueError, RecursionError):
        names = json.loads(listed)
        if isinstance(names, list):
            return [str(name) for name in names]
    return [name.strip() for name in listed.split(",") if name.strip()]


def _owner(distribution: object) -> str:
    return str(getattr(distribution, "name", "an installed package"))


def _load(key: str, load: Callable[[], ModuleType], name: str) -> None:
    """Import a plugin, unless it is loaded already.

    Raises:
        PluginError: It cannot be imported.
    """
    if key in _loaded:
        return
    try:
        _loaded[key] = load()
    # A user's module may raise any exception.
    except (Exception, SystemExit) as error:
        raise PluginError(
            f"The plugin {name} cannot be loaded: {_why(error)}"
        ) from error


def import_from_here(name: str) -> ModuleType:
    """Import a module of an installed package or of the current folder.

    Raises:
        ImportError: There is no module of that name.
    """
    here = os.getcwd()
    if here not in sys.path:
        # For an installed command, sys.path does not contain the current folder.
        sys.path.append(here)
    return import_module(name)


def _import_plugin(name: str) -> ModuleType:
    valid = "a plugin is a module, or a file that ends with .py"
    if Path(name).is_file():
        raise ImportError(f"the file is no Python module: {valid}")
    module = import_from_here(name)
    spec = module.__spec__
    if spec is not None and spec.loader is not None and spec.origin is None:
        del sys.modules[name]
        raise ImportError(f"the folder has no __init__.py: {valid}")
    return module


def _import_file(path: Path) -> ModuleType:
    digest = sha256(str(path).encode()).hexdigest()[:8]
    name = f"plugin_{re.sub(r'[^a-zA-Z0-9]', '_', path.stem)}_{digest}"
    spec = spec_from_file_location(name, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise FileNotFoundError(f"there is no file {path}")
    module = module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


def _why(error: BaseException) -> str:
    """Return the reason of a plugin's failure, with its line."""
    frames = traceback.extract_tb(error.__traceback__)
    inside = [f for f in frames if "importlib" not in f.filename and f.name != "_load"]
    where = [f for f in inside if Path(f.filename) != Path(__file__)]
    line = f" ({where[-1].filename}, line {where[-1].lineno})" if where else ""
    if isinstance(error, SystemExit):
        return (
            f"it ends the process{line}. Put the part that only a script runs below "
            'if __name__ == "__main__":.'
        )
    text = str(error).rstrip(".")
    return f"{type(error).__name__}: {text}{line}."
