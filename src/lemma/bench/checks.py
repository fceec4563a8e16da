"""What `lemma doctor` looks at, one function per question."""

import os
import sys
from collections.abc import Callable
from dataclasses import dataclass

import av
import mujoco

from lemma import __version__
from lemma.bench.machine import installed_version
from lemma.core.errors import LemmaError
from lemma.env.simulation import Simulation
from lemma.expert.expert import Expert
from lemma.robots.ur.kinematics import frames
from lemma.scene.rendering.gl_backend import choose_backend
from lemma.scene.rendering.renderer import Renderer
from lemma.tasks.suite import FREE_SPLIT, SUITE, load_instance

ENGINE = "3.17"
"""The series of MuJoCo that results are tied to."""
PYTHONS = ((3, 11), (3, 14))
"""The first supported Python, and the first that is not."""
PACKAGES = (
    *("numpy", "scipy", "numba", "gymnasium", "pettingzoo", "pyarrow", "pillow"),
    *("av", "tyro", "rich"),
)
_INSTALL = "python -m pip install lemma-bench"
_TASK = "stack"


@dataclass(frozen=True, slots=True)
class Check:
    """The answer to one question."""

    name: str
    ok: bool
    found: str
    """What there is, for people."""
    advice: str = ""
    """What to do about it, if it is not well."""
    essential: bool = True
    """Whether the benchmark cannot be used without it."""


def run_checks() -> list[Check]:
    """Return every check; none of them raises."""
    checks = [_python(), Check("lemma", True, __version__), _engine()]
    checks += [_package(name) for name in PACKAGES]
    checks.append(_attempt("rendering", _backend))
    checks.append(_attempt("physics and expert", _smoke))
    if checks[-2].ok:
        checks.append(_attempt("camera picture", _picture))
    checks += [_attempt("instances", _frozen), _cache(), _video()]
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


def _engine() -> Check:
    found = mujoco.__version__
    return Check(
        "mujoco",
        found.split(".")[:2] == ENGINE.split("."),
        found,
        f"Results are tied to the engine: python -m pip install 'mujoco~={ENGINE}.0'",
    )


def _package(name: str) -> Check:
    found = installed_version(name)
    return Check(name, found is not None, found or "missing", _INSTALL)


def _attempt(name: str, question: Callable[[], str]) -> Check:
    """Answer with what a function returns, or with what it raises."""
    try:
        return Check(name, True, question())
    except LemmaError as error:
        return Check(name, False, "does not work", str(error))
    except Exception as error:
        return Check(name, False, f"{type(error).__name__}: {error}", _REPORT)


_REPORT = "This should not happen: please report it with the output of this command."


def _backend() -> str:
    backend = choose_backend()
    kind = "software" if backend.is_software else "hardware"
    return f"{backend.name}: {backend.renderer} ({kind}; {backend.detail})"


def _smoke() -> str:
    instance = load_instance(_TASK, FREE_SPLIT, 0)
    simulation = Simulation(instance.scene)
    simulation.tick()
    plan = Expert(simulation.scene, instance.goal).plan()
    if plan is None or not plan.steps:
        raise RuntimeError(f"the expert found no plan for {instance.key}")
    return f"one step taken; the expert's plan for {instance.key} has {len(plan.steps)}"


def _picture() -> str:
    instance = load_instance(_TASK, FREE_SPLIT, 0)
    scene = Simulation(instance.scene).scene
    scene.refresh()
    image = Renderer().rgbd(scene.model, scene.data, "robot_0/camera")
    if image.rgb.min() == image.rgb.max():
        raise RuntimeError("the picture has one color only")
    height, width, _ = image.rgb.shape
    return f"{width}x{height}, color and depth"


def _frozen() -> str:
    return f"{len([load_instance(name, 'test', 0) for name in SUITE])} tasks' lists"


def _cache() -> Check:
    # Where one compiled function is kept, all are.
    path = frames.stats.cache_path
    return Check(
        "compiled code",
        path is not None and os.access(path, os.W_OK),
        f"kept in {path}",
        "The folder is read-only, so that every start compiles for half a minute. "
        "Set NUMBA_CACHE_DIR to a folder that you may write to.",
        essential=False,
    )


def _video() -> Check:
    codec = "libx264" in av.codecs_available
    return Check(
        "video encoder",
        codec,
        "libx264" if codec else "missing",
        "Only the videos of 'lemma demo' need it: python -m pip install --force "
        "--only-binary :all: av",
        essential=False,
    )
