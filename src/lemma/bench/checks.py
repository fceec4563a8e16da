"""The checks of `lemma doctor`, one function each.

Each function imports the package that it checks, so a failed import is a result, too.
"""

import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from lemma.bench.machine import installed_version
from lemma.core.errors import LemmaError
from lemma.core.version import DISTRIBUTION, extras
from lemma.core.version import VERSION as __version__

ENGINE = "3.17"
"""Minor version of MuJoCo that results depend on."""
PYTHONS = ((3, 11), (3, 14))
"""The first supported Python, and the first unsupported one after it."""
PACKAGES = (
    *("numpy", "scipy", "numba", "llvmlite", "gymnasium", "pettingzoo", "pyarrow"),
    *("pillow", "av", "matplotlib", "jinja2", "msgspec", "filelock", "tyro", "rich"),
)
_INSTALL = "python -m pip install lemma-bench"
_TASK = "stack"


@dataclass(frozen=True, slots=True)
class Check:
    """The result of one check."""

    name: str
    ok: bool
    found: str
    """Text of the finding."""
    advice: str = ""
    """Instructions after a failure."""
    essential: bool = True
    """Whether the benchmark needs it."""


def run_checks(*, all_states: bool = False) -> list[Check]:
    """Run all checks; none of them raises.

    Args:
        all_states: Whether to compare the states of every control mode in every task.
    """
    checks = [_python(), Check("lemma", True, __version__)]
    checks.append(_attempt("mujoco", _engine))
    checks += [_package(name) for name in PACKAGES]
    checks.append(_attempt("rendering", _backend))
    checks.append(_attempt("physics and expert", _smoke))
    if checks[-2].ok:
        checks.append(_attempt("camera picture", _picture))
    checks.append(_attempt("instances", _frozen))
    same = partial(_states, fast=not all_states)
    checks.append(_attempt("same states", same, essential=False))
    checks.append(_attempt("compiled code", _cache, essential=False))
    checks.append(_attempt("video encoder", _video, essential=False))
    checks += [_extra(name, packages) for name, packages in extras().items()]
    return checks


def _python() -> Check:
    found = ".".join(str(number) for number in sys.version_info[:3])
    first, end = PYTHONS
    return Check(
        "python",
        first <= sys.version_info[:2] < end,
        found,
        "Use Python 3.11, 3.12 or 3.13.",
    )


def _engine() -> str:
    from lemma.core.engine import mujoco

    found: str = mujoco.__version__
    if found.split(".")[:2] != ENGINE.split("."):
        raise _NotWellError(
            found,
            "Results are tied to the engine: python -m pip install "
            f"'mujoco~={ENGINE}.0'",
        )
    return found


def _package(name: str) -> Check:
    found = installed_version(name)
    return Check(name, found is not None, found or "missing", _INSTALL)


def _extra(name: str, packages: list[str]) -> Check:
    """Return whether the packages of an extra are installed; they are optional."""
    versions = {package: installed_version(package) for package in packages}
    return Check(
        f"extra {name}",
        None not in versions.values(),
        ", ".join(f"{each} {found or 'missing'}" for each, found in versions.items()),
        f"python -m pip install '{DISTRIBUTION}[{name}]', if you want it",
        essential=False,
    )


class _NotWellError(Exception):
    """A failed check, with finding and advice."""

    def __init__(self, found: str, advice: str) -> None:
        super().__init__(found)
        self.found, self.advice = found, advice


def _attempt(name: str, question: Callable[[], str], essential: bool = True) -> Check:
    """Return the result of a check, or its exception as a result."""
    try:
        return Check(name, True, question(), essential=essential)
    except _NotWellError as error:
        found, advice = error.found, error.advice
    except LemmaError as error:
        found, advice = "does not work", str(error)
    except ImportError as error:
        found, advice = f"cannot be imported: {error}", f"{_INSTALL} --force-reinstall"
    except Exception as error:
        found, advice = f"{type(error).__name__}: {error}", _REPORT
    return Check(name, False, found, advice, essential)


_REPORT = "This should not happen: please report it with the output of this command."


def _backend() -> str:
    from lemma.scene.rendering.gl_backend import choose_backend

    backend = choose_backend()
    kind = "software" if backend.is_software else "hardware"
    return f"{backend.name}: {backend.renderer} ({kind}; {backend.detail})"


def _smoke() -> str:
    from lemma.env.simulation import Simulation
    from lemma.expert.expert import Expert
    from lemma.tasks.suite import FREE_SPLIT, load_instance

    instance = load_instance(_TASK, FREE_SPLIT, 0)
    simulation = Simulation(instance.scene)
    simulation.tick()
    plan = Expert(simulation.scene, instance.goal).plan()
    if plan is None or not plan.steps:
        raise RuntimeError(f"the expert found no plan for {instance.key}")
    return f"one step taken; the expert's plan for {instance.key} has {len(plan.steps)}"


def _picture() -> str:
    from lemma.env.simulation import Simulation
    from lemma.scene.rendering.renderer import Renderer
    from lemma.tasks.suite import FREE_SPLIT, load_instance

    instance = load_instance(_TASK, FREE_SPLIT, 0)
    scene = Simulation(instance.scene).scene
    scene.refresh()
    image = Renderer().rgbd(scene.model, scene.data, "robot_0/camera")
    if image.rgb.min() == image.rgb.max():
        raise RuntimeError("the picture has one color only")
    height, width, _ = image.rgb.shape
    return f"{width}x{height}, color and depth"


def _frozen() -> str:
    from lemma.tasks.suite import SUITE, load_instance

    return f"{len([load_instance(name, 'test', 0) for name in SUITE])} tasks' lists"


def _states(*, fast: bool) -> str:
    from lemma.bench.states import all_cases, differing, fast_cases

    cases = fast_cases() if fast else all_cases()
    found = differing(cases, fast=fast)
    if found:
        names = ", ".join(case.key for case in found[:5])
        more = ", ..." if len(found) > 5 else ""
        raise _NotWellError(
            f"{len(found)} of {len(cases)} cases differ: {names}{more}",
            "The benchmark works, but episodes here differ in the last bits from those "
            f"of other machines. The hashes were made with MuJoCo {ENGINE} on x86-64.",
        )
    return f"{len(cases)} cases repeat their hashes"


def _cache() -> str:
    from lemma.core.kernels import cache_folder
    from lemma.robots.ur.kinematics import frames

    # One kernel stands for all: they share the same cache settings.
    path = cache_folder(frames)
    if path is None or not os.access(path, os.W_OK):
        raise _NotWellError(
            "not kept" if path is None else f"kept in {path}",
            "No cache folder is writable, so every start compiles for half a minute. "
            "Set NUMBA_CACHE_DIR to a folder that you may write to.",
        )
    return f"kept in {path}"


def _video() -> str:
    import av

    if "libx264" not in av.codecs_available:
        raise _NotWellError(
            "missing",
            "Only videos need it: python -m pip install --force-reinstall "
            "--only-binary :all: av",
        )
    return "libx264"
