"""LEMMA Bench: language-conditioned multi-robot manipulation on MuJoCo.

Importing this registers the tasks with Gymnasium and loads nothing heavy: the names
below are imported when they are first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from lemma.core.version import VERSION as __version__
from lemma.registration import (
    make,
    make_gpu_vec,
    parallel_env,
    register_environments,
    team_aec_env,
    team_parallel_env,
)

if TYPE_CHECKING:
    from lemma.core.plugins import load_plugins
    from lemma.dataset.recipe.files import load
    from lemma.env.episode import Episode
    from lemma.evaluation.evaluation import Evaluation, evaluate
    from lemma.expert.expert import Expert, solve
    from lemma.expert.policy import ExpertPolicy
    from lemma.planning.primitives import PRIMITIVES, PrimitiveSpec
    from lemma.robots.ur.arms import ARMS, ArmSpec
    from lemma.scene.objects.kind import OBJECT_KINDS, ObjectKind
    from lemma.scene.objects.palette import OBJECT_COLORS
    from lemma.tasks.instance import Instance
    from lemma.tasks.language.template import LanguageBank
    from lemma.tasks.suite import SUITE, SUITES, load_instance
    from lemma.tasks.task import TASKS, Task

__all__ = [
    "ARMS",
    "OBJECT_COLORS",
    "OBJECT_KINDS",
    "PRIMITIVES",
    "SUITE",
    "SUITES",
    "TASKS",
    "ArmSpec",
    "Episode",
    "Evaluation",
    "Expert",
    "ExpertPolicy",
    "Instance",
    "LanguageBank",
    "ObjectKind",
    "PrimitiveSpec",
    "Task",
    "__version__",
    "evaluate",
    "load",
    "load_instance",
    "load_plugins",
    "make",
    "make_gpu_vec",
    "parallel_env",
    "solve",
    "team_aec_env",
    "team_parallel_env",
]

_HOMES = {
    "ARMS": "lemma.robots.ur.arms",
    "ArmSpec": "lemma.robots.ur.arms",
    "Episode": "lemma.env.episode",
    "Evaluation": "lemma.evaluation.evaluation",
    "Expert": "lemma.expert.expert",
    "ExpertPolicy": "lemma.expert.policy",
    "Instance": "lemma.tasks.instance",
    "LanguageBank": "lemma.tasks.language.template",
    "OBJECT_COLORS": "lemma.scene.objects.palette",
    "OBJECT_KINDS": "lemma.scene.objects.entity",
    "ObjectKind": "lemma.scene.objects.kind",
    "PRIMITIVES": "lemma.planning.primitives",
    "PrimitiveSpec": "lemma.planning.primitives",
    "SUITE": "lemma.tasks.suite",
    "SUITES": "lemma.tasks.suite",
    "TASKS": "lemma.tasks.suite",
    "Task": "lemma.tasks.task",
    "evaluate": "lemma.evaluation.evaluation",
    "load": "lemma.dataset.recipe.files",
    "load_instance": "lemma.tasks.suite",
    "load_plugins": "lemma.core.plugins",
    "solve": "lemma.expert.expert",
}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    try:
        module = import_module(_HOMES[name])
    except AttributeError as error:
        # Python would take it for "there is no such name", and hide what is wrong.
        raise ImportError(f"{_HOMES[name]} cannot be imported: {error}") from error
    value = getattr(module, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """List the public names, those not imported yet too."""
    return sorted({*globals(), *__all__})


register_environments()
