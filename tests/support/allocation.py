"""Allocation alone: given sub-tasks, who does what (paper, section IV-B).

Maximise sum u_im v_im over binary v, with at most one robot per sub-task and
sum tau_im v_im <= T_max; a robot that cannot execute a sub-task has u = -infinity.
"""

from dataclasses import replace

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp

from lemma.core.errors import InvalidConfigError
from lemma.core.poses import FloatArray
from lemma.planning.grounding import GeometricGrounder
from lemma.planning.planner import Plan, utility
from lemma.planning.symbolic_state import SymbolicState
from lemma.tasks.goal import Goal


def allocate(
    utilities: FloatArray, durations_s: FloatArray, limit_s: float
) -> tuple[int, ...] | None:
    """Assign a robot to every sub-task, exactly.

    Args:
        utilities: u, (robots, sub-tasks); -inf where a robot cannot.
        durations_s: tau, (robots, sub-tasks) [s].
        limit_s: T_max, the largest summed duration [s].

    Returns:
        The robot of each sub-task, or None where no assignment covers them all.

    Raises:
        InvalidConfigError: The shapes differ or are not two-dimensional.
    """
    if utilities.ndim != 2 or utilities.shape != durations_s.shape:
        raise InvalidConfigError(
            f"Utilities {utilities.shape} and durations {durations_s.shape} must both "
            "be (robots, sub-tasks)."
        )
    robots, subtasks = utilities.shape
    if subtasks == 0:
        return ()
    able = np.isfinite(utilities)
    # Every covered sub-task is worth more than any utility can take away, so that the
    # solver leaves one out only where it must.
    reward = 1.0 + 2.0 * subtasks * float(np.abs(utilities[able]).max(initial=0.0))
    worth = np.where(able, utilities, 0.0) + reward
    once = np.kron(np.ones(robots), np.eye(subtasks))
    time = np.where(able, durations_s, 0.0).reshape(1, -1)
    result = milp(
        -worth.reshape(-1),
        constraints=[
            LinearConstraint(once, 0.0, 1.0),
            LinearConstraint(time, 0.0, limit_s),
        ],
        bounds=Bounds(0.0, able.astype(float).reshape(-1)),
        integrality=np.ones(robots * subtasks),
    )
    if result.x is None:
        return None
    chosen = np.round(result.x).reshape(robots, subtasks).astype(bool)
    if not chosen.any(axis=0).all():
        return None
    return tuple(int(robot) for robot in chosen.argmax(axis=0))


def pose_problem(
    now: SymbolicState, plan: Plan, goal: Goal, grounder: GeometricGrounder
) -> tuple[FloatArray, FloatArray]:
    """Ask for every sub-task of a plan what each robot would make of it.

    Args:
        now: The situation that the plan begins in.
        plan: The plan.
        goal: Its goal.
        grounder: Says what can be done.

    Returns:
        Utilities u, -inf where a robot cannot, and durations tau [s], each
        (robots, sub-tasks), for :func:`lemma.expert.allocation.allocate`.
    """
    robots = tuple(grounder.robots)
    utilities = np.full((len(robots), len(plan.steps)), -np.inf)
    durations = np.zeros_like(utilities)
    for m, step in enumerate(plan.steps):
        for i, robot in enumerate(robots):
            option = grounder.ground(replace(step.subtask, robot=robot), now)
            if option is not None:
                utilities[i, m] = utility(option, now, goal)
                durations[i, m] = option.duration_s
        now = step.after
    return utilities, durations
