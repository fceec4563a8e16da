"""Predicted times, by which two things are laid down at the same time.

A rule such as :class:`~lemma.tasks.teams.rule.Together` is kept by beginning the
shorter of two sub-tasks later. The prediction was fitted to 160 executed moves in the
first 80 training tables of *unison*; it errs by 0.3 s (standard deviation).
"""

from collections.abc import Collection, Mapping, Sequence

from lemma.env.team.orders import Team
from lemma.planning.geometry import GroundedOption
from lemma.scene.spec import RobotPlacement
from lemma.tasks.subtask import GroundedSubTask, SubTask
from lemma.tasks.teams.dependencies import meetings

_HANDLING_S = 3.88
_CARRYING_S_M = 0.65
"""Time for each metre from the grasp to the place [s/m]."""
_REACHING_S_M = 0.48
"""Time for each metre from the base to the grasp [s/m]."""
_FOLLOWING_S = 0.75
"""Wait of a robot for the one that has just put the object down [s]."""
_LEAVING_S = 0.6
"""Time from the release of an object until the robot is on its way home [s]."""


def until_laid_s(
    robot: RobotPlacement, subtask: GroundedSubTask, *, follows: bool = False
) -> float:
    """Predict the time from the begin of a move until its hand lets go [s].

    Args:
        robot: The robot.
        subtask: The move with its poses.
        follows: Whether another robot has just put the object down.
    """
    return (
        _HANDLING_S
        + _CARRYING_S_M * subtask.pick.distance(subtask.place)
        + _REACHING_S_M * robot.base.distance(subtask.pick)
        + (_FOLLOWING_S if follows else 0.0)
    )


class Aim:
    """Tells when sub-tasks of a plan must begin that end at the same time."""

    def __init__(
        self,
        team: Team,
        steps: Sequence[SubTask],
        needs: Sequence[Mapping[int, str]],
    ) -> None:
        """Predict the times of a plan; without such a rule there is nothing to predict.

        Args:
            team: The robots. Their orders are the first steps of the plan, if any.
            steps: The plan.
            needs: Earlier steps that each step depends on.
        """
        self._steps, self._needs = steps, needs
        self._until_s: dict[int, float] = {}
        self._end_s: dict[int, float] = {}
        self._partners = meetings(steps, team.episode.instance.goal.rule)
        if self._partners:
            self._predict(team)

    def _predict(self, team: Team) -> None:
        """Ground all steps one after another, as far as that is possible."""
        robots, state = team.grounder.robots, team.observe()
        for k, step in enumerate(self._steps):
            order = team.orders.get(step.robot)
            option: GroundedOption | None
            if order is not None and order.subtask == step:
                option = order.option
            else:
                option = team.grounder.ground(step, state)
            if option is None:
                return
            state = option.after
            follows = any(self._steps[i].pick == step.pick for i in self._needs[k])
            placed = robots[step.robot]
            until_s = until_laid_s(placed, option.grounded, follows=follows)
            self._until_s[k], self._end_s[k] = until_s, option.duration_s

    def is_due(
        self,
        number: int,
        now_s: float,
        begun: Mapping[int, float],
        have: Collection[int],
        pause_s: float = 0.0,
    ) -> bool:
        """Return whether a step must not wait any longer.

        Args:
            number: Index of a step that could begin.
            now_s: Simulated time [s].
            begun: When steps that have not ended began [s].
            have: Steps that have had their effect.
            pause_s: Time until the next moment at which it could begin [s].
        """
        other = self._partners.get(number)
        if other is None or other in have or not {number, other} <= {*self._until_s}:
            return True
        laid_s = self._begin_s(other, now_s, begun, have) + self._until_s[other]
        return now_s + self._until_s[number] >= laid_s - 0.5 * pause_s

    def _begin_s(
        self,
        number: int,
        now_s: float,
        begun: Mapping[int, float],
        have: Collection[int],
    ) -> float:
        """Return when a step began, or when it can begin at the earliest [s]."""
        if number in begun:
            return begun[number]
        at_s = now_s
        for k in range(number):
            needed = k in self._needs[number] and k not in have
            same = self._steps[k].robot == self._steps[number].robot
            if not needed and (not same or (k in have and k not in begun)):
                continue
            since_s = self._begin_s(k, now_s, begun, have)
            if needed:
                at_s = max(at_s, since_s + self._until_s[k] + _LEAVING_S)
            if same:
                at_s = max(at_s, since_s + self._end_s[k])
        return at_s
