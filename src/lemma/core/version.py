"""The version of the package, and its extras."""

import re
from importlib.metadata import PackageNotFoundError, requires

VERSION = "0.1.0"
DISTRIBUTION = "lemma-bench"
DEVELOPMENT = ("dev", "docs")
"""Extras for developers of this package."""
_OPTIONAL = re.compile(r"([\w.-]+).*\bextra == ['\"]([\w-]+)['\"]")


def extras() -> dict[str, list[str]]:
    """Return the packages of each extra, without the extras for developers."""
    found: dict[str, list[str]] = {}
    try:
        lines = requires(DISTRIBUTION) or []
    except PackageNotFoundError:
        return found
    for match in filter(None, map(_OPTIONAL.match, lines)):
        package, extra = match.groups()
        if extra not in DEVELOPMENT:
            found.setdefault(extra, []).append(package)
    return found


def extra_of(module: str) -> str | None:
    """Return the extra that installs a module; None if there is none.

    Args:
        module: Full name of the module.
    """
    package = module.partition(".")[0].replace("_", "-")
    for extra, packages in extras().items():
        if package in [name.replace("_", "-") for name in packages]:
            return extra
    return None
