"""Attacks on instances: who tries what, how far it gets, and whether that repeats."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lemma.audit.attack import ATTACKS, LEVELS, Attack, AttemptOver, GiveUp
from lemma.audit.control_trial import ControlTable
from lemma.audit.skill_trial import SkillTable
from lemma.core.arguments import known
from lemma.core.errors import PhysicsError
from lemma.core.seeding import stream
from lemma.core.workers.pool import Engine, run_in_order
from lemma.tasks.instance import Instance
from lemma.tasks.subtask import GroundedSubTask
from lemma.tasks.suite import load_instance

for _name in (
    *("skill.drag_home", "skill.push_onto_pad", "skill.carry_on_stick"),
    *("skill.push_tower", "skill.shove", "skill.search", "skill.plan_order"),
    *("control.tilted_move", "control.rake", "control.hand_push"),
    *("control.tilted_stick", "control.tip_off_stick", "control.tower_push"),
    *("control.topple", "control.strike", "control.fling", "control.throw"),
    *("chain.stick_relay", "chain.cube_chain"),
):
    import_module(f"lemma.audit.{_name}")


@dataclass(frozen=True, slots=True)
class Found:
    """What one attack did to one instance."""

    attack: str
    level: str
    task: str
    split: str
    index: int
    acted: bool
    """Whether anything was executed; if not, geometry said that it cannot work."""
    succeeded: bool
    progress: float
    """Most of the goal that ever held, in [0, 1]."""
    robot: str = ""
    """Who succeeded."""
    attempt: int = 0
    """In which attempt."""
    subtasks: tuple[GroundedSubTask, ...] = ()
    """What it did, at skill level."""
    commands: NDArray[np.float32] | None = None
    """What it commanded, at control level, (steps, robots, numbers)."""
    unstable: int = 0
    """Attempts that ended because the physics became unstable."""


_Table = SkillTable | ControlTable
_TABLES: dict[str, Callable[[Instance], _Table]] = {
    "skill": SkillTable,
    "control": ControlTable,
}


def names_at(level: str) -> tuple[str, ...]:
    """Return the attacks of a level, or of ``"both"``.

    Raises:
        UnknownNameError: No such level.
    """
    known("level", level, (*LEVELS, "both"))
    return tuple(n for n in ATTACKS if level in ("both", ATTACKS[n].level))


def audit_instance(instance: Instance, names: Iterable[str]) -> Iterator[Found]:
    """Play attacks on an instance, with each of its robots.

    Args:
        instance: The problem.
        names: Of attacks.

    Yields:
        What each did; it ends with the first success of a robot.
    """
    tables: dict[str, _Table] = {}
    for name in names:
        record = ATTACKS[name]
        if record.level not in tables:
            tables[record.level] = _TABLES[record.level](instance)
        yield _play(record, instance, tables[record.level])


def cheap_attacks_succeed(instance: Instance) -> str | None:
    """Return the name of a cheap attack that succeeds; None if none does.

    For the sampling of lists: an instance that one robot solves is none.
    """
    cheap = (name for name in ATTACKS if ATTACKS[name].cheap)
    for found in audit_instance(instance, cheap):
        if found.succeeded:
            return found.attack
    return None


def audit(
    keys: Sequence[tuple[str, str, int]],
    names: tuple[str, ...],
    engine: Engine,
    advance: Callable[[int], None] = lambda count: None,
) -> list[Found]:
    """Play attacks on many instances.

    Args:
        keys: Task, split and index of each instance.
        names: Of attacks.
        engine: Where to work.
        advance: Told of each instance that is done with.

    Returns:
        What each attack did to each instance, in the order of the keys, whoever worked
        on which.
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


def _play(record: Attack, instance: Instance, table: _Table) -> Found:
    """Make all attempts of an attack, until one succeeds."""
    key = (record.name, record.level, instance.task, instance.split, instance.index)
    acted, progress, unstable = False, 0.0, 0
    robots = instance.scene.robot_names
    for robot in robots[:1] if record.team else robots:
        for attempt in range(record.attempts):
            rng = stream("audit", record.name, instance.key, robot, attempt)
            trial: Any = table.begin(robot, rng, attempt)
            try:
                won = _attempt(record, trial)
            except PhysicsError:
                # What is simulated means nothing any more, so nothing is won by it.
                won, unstable = False, unstable + 1
            if won is None:
                break
            acted = acted or trial.acted
            progress = max(progress, trial.best_progress)
            if won:
                return Found(
                    *key, True, True, 1.0, robot, attempt, **trial.what_was_done()
                )
    return Found(*key, acted, False, progress, unstable=unstable)


def _attempt(record: Attack, trial: Any) -> bool | None:
    """Make one attempt; return whether it succeeded, None if geometry gave it up."""
    try:
        record.play(trial)
    except AttemptOver:
        pass
    except GiveUp:
        if not trial.acted:
            return None
    return bool(trial.acted and trial.finish())
