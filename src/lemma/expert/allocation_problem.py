"""The allocation problem of a plan: its sub-tasks without their robots."""

from dataclasses import replace

import numpy as np

from lemma.core.poses import FloatArray
from lemma.expert.grounding import OracleGrounder
from lemma.expert.planner import Plan, utility
from lemma.expert.situation import Situation
from lemma.tasks.goal import Goal


def pose_problem(
    now: Situation, plan: Plan, goal: Goal, grounder: OracleGrounder
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
