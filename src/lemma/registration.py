"""Where environments are made, and made known to Gymnasium.

Importing this module is cheap: what simulates is imported when an environment is made.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any, Literal, overload

from lemma.tasks.names import LISTED, gym_id

if TYPE_CHECKING:
    from lemma.env.base_env import LemmaEnv
    from lemma.env.control_env import ControlEnv
    from lemma.env.learning.parallel_env import LemmaParallelEnv
    from lemma.env.learning.team_views import TeamAECEnv, TeamParallelEnv
    from lemma.env.skill_env import SkillEnv
    from lemma.env.team.team_env import TeamPlanEnv, TeamSkillEnv
    from lemma.expert.plan_env import PlanEnv
    from lemma.warp.vector_env import GpuVecEnv

LEVELS = {
    "control": "lemma.env.control_env:ControlEnv",
    "skill": "lemma.env.skill_env:SkillEnv",
    "plan": "lemma.expert.plan_env:PlanEnv",
}
"""The environment of each level of action."""
TOGETHER = {
    "skill": "lemma.env.team.team_env:TeamSkillEnv",
    "plan": "lemma.env.team.team_env:TeamPlanEnv",
}
"""The same where several robots act at once."""
ACTING = ("turns", "together")


def register_environments() -> None:
    """Make the suites known to Gymnasium: ``import lemma`` does it.

    Tasks of users are made known when they are added to :data:`lemma.TASKS`.
    """
    registration = import_module("gymnasium.envs.registration")
    for task in LISTED:
        if gym_id(task) not in registration.registry:
            registration.register(
                id=gym_id(task),
                entry_point="lemma.registration:make",
                kwargs={"task": task},
            )


@overload
def make(
    task: str,
    *,
    level: Literal["control"] = "control",
    render_mode: str | None = None,
    **options: Any,
) -> "ControlEnv": ...
@overload
def make(
    task: str,
    *,
    level: Literal["skill"],
    acting: Literal["turns"] = "turns",
    render_mode: str | None = None,
    **options: Any,
) -> "SkillEnv": ...
@overload
def make(
    task: str,
    *,
    level: Literal["plan"],
    acting: Literal["turns"] = "turns",
    render_mode: str | None = None,
    **options: Any,
) -> "PlanEnv": ...
@overload
def make(
    task: str,
    *,
    level: Literal["skill"],
    acting: Literal["together"],
    render_mode: str | None = None,
    **options: Any,
) -> "TeamSkillEnv": ...
@overload
def make(
    task: str,
    *,
    level: Literal["plan"],
    acting: Literal["together"],
    render_mode: str | None = None,
    **options: Any,
) -> "TeamPlanEnv": ...
@overload
def make(
    task: str,
    *,
    level: str,
    acting: str = "turns",
    render_mode: str | None = None,
    **options: Any,
) -> "LemmaEnv": ...
def make(
    task: str,
    *,
    level: str = "control",
    acting: str = "turns",
    render_mode: str | None = None,
    **options: Any,
) -> "LemmaEnv":
    """Make an environment, without Gymnasium's wrappers.

    Args:
        task: Name of a task, ``"poke_stack"``, or its Gymnasium id; also of a task of
            your own.
        level: ``"control"`` for commands to motors, ``"skill"`` for grounded sub-tasks,
            ``"plan"`` for symbolic ones.
        acting: ``"turns"``: one sub-task at a time; ``"together"``, at the levels of
            sub-tasks: orders to all free robots (:mod:`lemma.env.team.team_env`).
        render_mode: ``"rgb_array"`` to render, or None.
        **options: Fields of :class:`lemma.env.config.EnvConfig`.

    Raises:
        UnknownNameError: No such task, level, option, or value of an option.
        InvalidConfigError: An option has an impossible value.
    """
    known = import_module("lemma.core.arguments").known
    known("level", level, LEVELS)
    known("acting", acting, ACTING)
    if acting == "together" and level not in TOGETHER:
        raise import_module("lemma.core.errors").InvalidConfigError(
            'acting="together" is for level="skill" and "plan". At control level all '
            "robots are commanded at once anyway."
        )
    tasks = import_module("lemma.tasks.suite").TASKS
    by_id = {gym_id(name): name for name in tasks}
    known_task = by_id.get(task, task) if isinstance(task, str) else task
    config = import_module("lemma.env.config").EnvConfig.from_options(
        {"task": known_task, **options}
    )
    if acting == "turns" and level != "control":
        tasks[config.task].check_in_turns()
    module, _, name = (TOGETHER if acting == "together" else LEVELS)[level].partition(
        ":"
    )
    env: LemmaEnv = getattr(import_module(module), name)(config, render_mode)
    return env


def make_gpu_vec(task: str, num_envs: int = 4096, **options: Any) -> "GpuVecEnv":
    """Make many environments at once on a GPU, for training; see ``docs/gpu.md``.

    Args:
        task: Name of a task with cubes and pads.
        num_envs: How many tables.
        **options: Of :class:`lemma.warp.vector_env.GpuVecEnv`.

    Raises:
        UnknownNameError: No such task or arm.
        InvalidConfigError: An option or the task is impossible there.
    """
    env: GpuVecEnv = import_module("lemma.warp.vector_env").GpuVecEnv(
        task, num_envs, **options
    )
    return env


def parallel_env(
    task: str, *, render_mode: str | None = None, **options: Any
) -> "LemmaParallelEnv":
    """Make a PettingZoo environment: one agent per robot, at control level.

    Args:
        task: As for :func:`make`.
        render_mode: ``"rgb_array"`` to render, or None.
        **options: Fields of :class:`lemma.env.config.EnvConfig`.

    Raises:
        UnknownNameError: No such task, option, or value of an option.
        InvalidConfigError: An option has an impossible value.
    """
    inner = make(task, level="control", render_mode=render_mode, **options)
    env: LemmaParallelEnv = import_module(
        "lemma.env.learning.parallel_env"
    ).LemmaParallelEnv(inner)
    return env


def team_parallel_env(
    task: str, *, level: str = "plan", render_mode: str | None = None, **options: Any
) -> "TeamParallelEnv":
    """Make a PettingZoo environment whose agents are asked for orders, all at once.

    Args:
        task: As for :func:`make`.
        level: ``"plan"`` or ``"skill"``.
        render_mode: ``"rgb_array"`` to render, or None.
        **options: Fields of :class:`lemma.env.config.EnvConfig`.

    Raises:
        UnknownNameError: No such task, option, or value of an option.
        InvalidConfigError: An option has an impossible value.
    """
    env: TeamParallelEnv = _team_view(
        "TeamParallelEnv", task, level, render_mode, options
    )
    return env


def team_aec_env(
    task: str, *, level: str = "plan", render_mode: str | None = None, **options: Any
) -> "TeamAECEnv":
    """Make a PettingZoo environment whose free agents are asked one after another.

    Args:
        task: As for :func:`make`.
        level: ``"plan"`` or ``"skill"``.
        render_mode: ``"rgb_array"`` to render, or None.
        **options: Fields of :class:`lemma.env.config.EnvConfig`.

    Raises:
        UnknownNameError: No such task, option, or value of an option.
        InvalidConfigError: An option has an impossible value.
    """
    env: TeamAECEnv = _team_view("TeamAECEnv", task, level, render_mode, options)
    return env


def _team_view(
    name: str, task: str, level: str, render_mode: str | None, options: dict[str, Any]
) -> Any:
    inner = make(
        task, level=level, acting="together", render_mode=render_mode, **options
    )
    return getattr(import_module("lemma.env.learning.team_views"), name)(inner)
