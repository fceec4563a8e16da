"""The expert: plans, grounds, executes, observes, and plans again."""

from collections.abc import Iterator
from dataclasses import dataclass

from lemma.env.episode import Episode
from lemma.motion.outcome import SkillResult
from lemma.planning.grounding import GeometricGrounder, GroundedOption
from lemma.planning.planner import Plan, find_plan
from lemma.planning.symbolic_state import SymbolicState
from lemma.scene.objects.entity import STICK
from lemma.scene.scene import Scene
from lemma.tasks.goal import Goal
from lemma.tasks.subtask import STOP, GroundedSubTask, SubTask

_AS_PREDICTED_M = 0.03
_MAX_STEPS = 30
"""Limit on sub-tasks. No task needs more than 7, but failures may repeat some."""


@dataclass(frozen=True, slots=True)
class ExpertStep:
    """One executed sub-task."""

    subtask: SubTask
    grounded: GroundedSubTask
    result: SkillResult
    start_s: float
    """Simulated time at which it began [s]."""


class Expert:
    """The oracle as planner and grounder, with access to the true state.

    It keeps its plan while the state is as predicted, and plans again if a sub-task
    failed or an object is not where the plan predicted it.
    """

    def __init__(
        self, scene: Scene, goal: Goal, team: tuple[str, ...] | None = None
    ) -> None:
        """Prepare for a scene and a goal.

        Args:
            scene: The scene.
            goal: The goal.
            team: Robots that may act; all if None.
        """
        self._scene = scene
        self._goal = goal
        self._team = team
        self._grounder = GeometricGrounder(scene.spec)
        self._queue: list[GroundedOption] = []
        self._expected: SymbolicState | None = None
        self.replans = -1
        """Number of times that the expert planned again."""

    def plan(self) -> Plan | None:
        """Return the plan of highest utility from the present state, or None."""
        return self._plan_from(SymbolicState.observe(self._scene))

    def act(self) -> tuple[SubTask, GroundedSubTask | None]:
        """Return the next sub-task and its poses.

        If the goal holds or there is no plan, the result is ``STOP`` and None.

        Raises:
            InvalidConfigError: Robots that act in turns cannot reach the goal.
        """
        self._goal.check_in_turns()
        now = SymbolicState.observe(self._scene)
        if self._expected is not None and not _agree(now, self._expected):
            self._queue = []
        if not self._queue and self._goal.progress(self._scene) < 1.0:
            self._plan_anew(now)
        if not self._queue:
            return STOP, None
        step = self._grounder.ground(self._queue.pop(0).subtask, now)
        if step is None:
            # Small deviations from the predicted poses have made it infeasible.
            self._plan_anew(now)
            if not self._queue:
                self._expected = None
                return STOP, None
            step = self._queue.pop(0)
        self._expected = step.after
        return step.subtask, step.grounded

    def _plan_from(self, now: SymbolicState) -> Plan | None:
        return find_plan(now, self._goal, self._grounder, team=self._team)

    def _plan_anew(self, now: SymbolicState) -> None:
        self.replans += 1
        plan = self._plan_from(now)
        self._queue = list(plan.steps) if plan is not None else []

    def notice(self, result: SkillResult) -> None:
        """Process the result of the last sub-task; a failure discards the plan."""
        if not result.ok:
            self._queue, self._expected = [], None


def solve(episode: Episode, expert: Expert | None = None) -> Iterator[ExpertStep]:
    """Solve an episode with an expert; yield every executed sub-task.

    Args:
        episode: The episode in progress.
        expert: The expert, for the same scene and goal; a new one if None.
    """
    expert = expert or Expert(episode.simulation.scene, episode.instance.goal)
    for _ in range(_MAX_STEPS):
        subtask, grounded = expert.act()
        if grounded is None:
            break
        start = episode.elapsed_s
        result = episode.execute(grounded)
        expert.notice(result)
        yield ExpertStep(subtask, grounded, result, start)
        if episode.is_over:
            return
    episode.stop()


def _agree(now: SymbolicState, expected: SymbolicState) -> bool:
    """Return whether supports, and poses except the stick's, are as predicted."""
    if now.fallen != expected.fallen or (
        (now.supports, now.seconds) != (expected.supports, expected.seconds)
    ):
        return False
    return all(
        now.poses[name].distance(pose) < _AS_PREDICTED_M
        for name, pose in expected.poses.items()
        if name != STICK
    )
