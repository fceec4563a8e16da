"""What lets the real lerobot be imported where its own requirements cannot be met.

Nothing of this is part of the package, and none of it stands in for anything that the
tests use: the code of lerobot that reads a data set runs as it was published. Where an
environment meets the requirements, neither function does anything.
"""

import builtins
import re
import sys
from importlib import import_module
from importlib.machinery import SourceFileLoader
from types import CodeType
from typing import Any, TypeVar

_ALIAS = re.compile(r"^type (\w+) = ", re.MULTILINE)
_GENERIC = re.compile(r"^(class|def) (\w+)\[([^\]]+)\](\(.*|:)", re.MULTILINE)


def allow_new_syntax() -> None:
    """Let Python 3.11 read lerobot 0.6, which says type parameters as 3.12 does.

    ``class Name[T]:`` is read as ``class Name(Generic[T]):``, ``def name[T](...)`` as
    ``def name(...)``, and ``type Name = ...`` as an assignment. No statement
    that does anything is changed.
    """
    if sys.version_info >= (3, 12):
        return
    original = SourceFileLoader.source_to_code

    def source_to_code(
        self: SourceFileLoader, data: Any, path: Any, **options: Any
    ) -> CodeType:
        if "/lerobot/" in str(path) and isinstance(data, bytes):
            data = in_old_syntax(data.decode()).encode()
        return original(self, data, path, **options)

    SourceFileLoader.source_to_code = source_to_code  # type: ignore[assignment]
    # What was compiled before, perhaps without this, is not to be used.
    sys.dont_write_bytecode = True


def in_old_syntax(source: str) -> str:
    """Return a module without the type parameters that Python 3.12 introduced."""
    return _GENERIC.sub(_rewrite, _ALIAS.sub(r"\1 = ", source))


def _rewrite(found: re.Match[str]) -> str:
    kind, name, parameters, rest = found.group(1, 2, 3, 4)
    names = [each.partition(":")[0].strip() for each in parameters.split(",")]
    for each in names:
        # Where every module finds it: before a class there may be decorators.
        setattr(builtins, each, TypeVar(each))
    if kind == "def":
        return f"def {name}{rest}"
    generic = f"__import__('typing').Generic[{', '.join(names)}]"
    bases = "):" if rest == ":" else f", {rest.removeprefix('(')}"
    return f"class {name}({generic}{bases}"


def allow_torchvision_without_operators() -> None:
    """Let torchvision be imported where its compiled operators do not fit torch.

    Its wheels on PyPI are compiled for CUDA and one version of torch. Without its
    operators it still describes two of them to torch, which then has never heard of
    them. Here torch is told their signatures, for torchvision to go on; nobody calls
    them.
    """
    try:
        import_module("torchvision")
    except RuntimeError as error:
        if "torchvision::" not in str(error):
            raise
        for name in [name for name in sys.modules if name.startswith("torchvision")]:
            del sys.modules[name]
        operators = import_module("torch").library.Library("torchvision", "DEF")
        operators.define("nms(Tensor dets, Tensor scores, float threshold) -> Tensor")
        import_module("torchvision")
