"""The audit: attacks on instances, their outcomes, and sums over the outcomes."""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lemma.audit.attack import ATTACKS, TRIALS, Attack
from lemma.audit.trial import AttemptOver, GiveUp, Trial
from lemma.core.arguments import known
from lemma.core.errors import PhysicsError
from lemma.core.seeding import stream
from lemma.core.workers.pool import Engine, run_in_order
from lemma.planning.grounding import GeometricGrounder
from lemma.planning.planner import find_plan
from lemma.planning.symbolic_state import SymbolicState
from lemma.scene.scene import Scene
from lemma.tasks.instance import Instance
from lemma.tasks.subtask import GroundedSubTask
from lemma.tasks.suite import TASKS, load_instance

# Importing a module registers its attacks.
for _name in (
    *("skill.stick", "skill.push", "skill.plan"),
    *(
        "control.hand",
        "control.flight",
        "control.lob",
        "control.edge",
        "control.search",
        "control.row",
        "control.stick",
        "control.handle",
    ),
):
    import_module(f"lemma.audit.{_name}")


@dataclass(frozen=True, slots=True)
class Found:
    """The outcome of one attack on one instance."""

    attack: str
    level: str
    task: str
    split: str
    index: int
    acted: bool
    """Whether anything was executed; if not, geometry ruled the attack out."""
    succeeded: bool
    progress: float
    """Largest share of the goal that held at any time, in [0, 1]."""
    robot: str = ""
    """The robot that succeeded."""
    attempt: int = 0
    """The attempt that succeeded."""
    subtasks: tuple[GroundedSubTask, ...] = ()
    """The successful sub-tasks, at skill level."""
    commands: NDArray[np.float32] | None = None
    """The successful commands, at control level, (steps, robots, numbers of one
    robot's action)."""
    unstable: int = 0
    """Attempts that ended because the physics became unstable."""
    simulated_s: float = 0.0
    """Simulated time of all attempts with all robots, including undone parts [s]."""
    seconds: float = 0.0
    """Processor time [s]; only this field depends on the machine."""


def names_at(level: str) -> tuple[str, ...]:
    """Return the attacks of a level, or of ``"both"``.

    Raises:
        UnknownNameError: No such level.
    """
    known("level", level, (*TRIALS, "both"))
    return tuple(n for n in ATTACKS if level in ("both", ATTACKS[n].level))


def audit_instance(instance: Instance, names: Iterable[str]) -> Iterator[Found]:
    """Play attacks on an instance, with each of its robots.

    Args:
        instance: The problem.
        names: Names of attacks.

    Yields:
        The outcome of each attack; an attack ends with its first success.
    """
    begun: dict[str, tuple[Any, Any]] = {}
    robots = attackers(instance)
    for name in names if robots else ():
        level = ATTACKS[name].level
        if level not in begun:
            world = TRIALS[level].begin(instance)
            begun[level] = world, world.snapshot()
        start_s = time.process_time()
        found = _play(ATTACKS[name], instance, robots, *begun[level])
        yield replace(found, seconds=time.process_time() - start_s)


def budgets(names: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Return the limits of attacks, ready for JSON.

    See :attr:`~lemma.audit.attack.Attack.budget`.
    """
    return {name: ATTACKS[name].budget for name in names}


def attackers(instance: Instance) -> tuple[str, ...]:
    """Return the robots that must not reach the goal alone.

    Returns:
        All robots. In a task that one robot can do alone: those that cannot. None if
        the goal has a condition on a hand's position.
    """
    robots, goal = instance.scene.robot_names, instance.goal
    if len(goal.placements) < len(goal.conjuncts):
        return ()
    if not TASKS[instance.task].alone:
        return robots
    now = SymbolicState.observe(Scene(instance.scene))
    grounder = GeometricGrounder(instance.scene)
    return tuple(r for r in robots if not find_plan(now, goal, grounder, team=(r,)))


def cheap_attacks_succeed(instance: Instance) -> str | None:
    """Return the name of a cheap attack that succeeds; None if none does.

    The sampling of lists rejects such instances, since one robot solves them.
    """
    cheap = (name for name in ATTACKS if ATTACKS[name].cheap)
    found = audit_instance(instance, cheap)
    return next((one.attack for one in found if one.succeeded), None)


def audit(
    keys: Sequence[tuple[str, str, int]],
    names: tuple[str, ...],
    engine: Engine,
    advance: Callable[[int], None] = lambda count: None,
) -> list[Found]:
    """Play attacks on many instances.

    Args:
        keys: Task, split and index of each instance.
        names: Names of attacks.
        engine: Workers that run the jobs.
        advance: Called with the number of instances that are newly finished.

    Returns:
        The outcomes in the order of the keys and names, for any number of workers.
    """
    found: list[Found] = []
    for some in run_in_order(engine, _audit_key, [(*key, names) for key in keys]):
        found += some
        advance(1)
    return found


def _audit_key(
    task: str, split: str, index: int, names: tuple[str, ...]
) -> list[Found]:
    return list(audit_instance(load_instance(task, split, index), names))


def _play(
    attack: Attack, instance: Instance, robots: Sequence[str], world: Any, start: Any
) -> Found:
    """Make all attempts of an attack, until one succeeds."""
    key = (attack.name, attack.level, instance.task, instance.split, instance.index)
    acted, progress, unstable, simulated_s = False, 0.0, 0, 0.0
    for robot in robots[:1] if attack.team else robots:
        for attempt in range(attack.attempts):
            rng = stream("audit", attack.name, instance.key, robot, attempt)
            world.restore(start)
            trial: Trial = TRIALS[attack.level](world, robot, rng, attempt)
            trial.limit_s = attack.simulated_s
            try:
                won = _attempt(attack.play, trial)
            except PhysicsError:
                # The simulation is no longer valid, so the attempt failed.
                won, unstable = False, unstable + 1
            simulated_s += trial.simulated_s
            if won is None:
                break
            acted = acted or trial.acted
            progress = max(progress, trial.best_progress)
            if won:
                done = trial.record() | {"simulated_s": simulated_s}
                return Found(*key, True, True, 1.0, robot, attempt, **done)
    return Found(
        *key, acted, False, progress, unstable=unstable, simulated_s=simulated_s
    )


def _attempt(play: Any, trial: Trial) -> bool | None:
    """Make one attempt; return whether it succeeded, None if geometry rules it out."""
    try:
        play(trial)
    except AttemptOver:
        pass
    except GiveUp:
        if not trial.acted:
            return None
    return trial.acted and trial.finish()


def tally(found: Iterable[Found]) -> dict[str, dict[str, dict[str, Any]]]:
    """Return sums by attack and task, ready for JSON, in the order of the outcomes.

    ``tried`` counts instances, ``executed`` those in which an attack acted because
    geometry did not rule it out. ``best_progress`` is the largest share of a goal that
    held at any time, in [0, 1]. ``simulated_s`` and ``seconds`` are sums of simulated
    and of processor time [s].
    """
    tallies: dict[str, dict[str, dict[str, Any]]] = {}
    for one in found:
        sums = tallies.setdefault(one.attack, {}).setdefault(
            one.task,
            {
                **{"level": one.level, "tried": 0, "executed": 0},
                **{"succeeded": 0, "best_progress": 0.0},
                **{"simulated_s": 0.0, "seconds": 0.0},
            },
        )
        sums["tried"] += 1
        sums["executed"] += one.acted
        sums["succeeded"] += one.succeeded
        sums["best_progress"] = max(sums["best_progress"], one.progress)
        sums["simulated_s"] = round(sums["simulated_s"] + one.simulated_s, 3)
        sums["seconds"] = round(sums["seconds"] + one.seconds, 3)
    return tallies
