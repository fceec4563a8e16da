"""One attempt at an instance with grounded sub-tasks of one robot."""

import math

import numpy as np

from lemma.audit.attack import AttemptOver, Lost
from lemma.core.poses import Pose2
from lemma.env.episode import Episode, EpisodeSnapshot
from lemma.expert.grounding import GeometricGrounder
from lemma.expert.planner import Plan, find_plan
from lemma.expert.symbolic_state import SymbolicState
from lemma.motion.outcome import SkillResult
from lemma.robots.reach import Reach, reach_of
from lemma.scene.spec import RobotPlacement
from lemma.tasks.instance import Instance
from lemma.tasks.subtask import GroundedSubTask, Primitive

_UNLIMITED_S = 1000.0


class SkillTrial:
    """What an attack at skill level sees and may do."""

    def __init__(
        self, episode: Episode, robot: str, rng: np.random.Generator, attempt: int = 0
    ) -> None:
        """Begin an attempt.

        Args:
            episode: At its beginning.
            robot: Who acts.
            rng: Where every draw comes from.
            attempt: Number of the attempt.
        """
        self.episode = episode
        self.instance = episode.instance
        self.goal = episode.instance.goal
        self.scene = episode.simulation.scene
        self.robot = robot
        self.rng = rng
        self.attempt = attempt
        self.grounder = GeometricGrounder(self.scene.spec)
        self.best_progress = 0.0
        """Most of the goal that ever held between two sub-tasks."""
        self.acted = False
        """Whether anything was executed, taken back or not."""

    @property
    def placement(self) -> RobotPlacement:
        """The robot that acts: arm type and base."""
        return self.grounder.robots[self.robot]

    @property
    def reach(self) -> Reach:
        """Its reach, pointing down."""
        return reach_of(self.placement.arm)

    def state(self) -> SymbolicState:
        """Return where things are now."""
        return SymbolicState.observe(self.scene)

    def pose(self, name: str) -> Pose2:
        """Return where an object is now."""
        return self.scene.pose2(name)

    def radius(self, pose: Pose2) -> float:
        """Return the distance of a position from the robot's base [m]."""
        return self.placement.base.distance(pose)

    def margin(self, pose: Pose2) -> float:
        """Return how far inside the robot's reach a position is [m]."""
        return self.reach.margin(self.placement.base, pose.x, pose.y)

    def outward(self, pose: Pose2) -> float:
        """Return the direction from the robot's base to a position [rad]."""
        base = self.placement.base
        return math.atan2(pose.y - base.y, pose.x - base.x)

    def at(self, radius_m: float, bearing: float) -> tuple[float, float]:
        """Return a position by distance and direction from the robot's base [m]."""
        base = self.placement.base
        x = base.x + radius_m * math.cos(bearing)
        return x, base.y + radius_m * math.sin(bearing)

    def move(self, pick: Pose2, place: Pose2) -> SkillResult:
        """Pick up what lies at a pose and put it down at another."""
        return self.do(GroundedSubTask(self.robot, Primitive.MOVE, pick, place))

    def do(self, subtask: GroundedSubTask) -> SkillResult:
        """Execute a grounded sub-task, as a step of the environment does.

        Raises:
            AttemptOver: The goal is reached, or the time is up.
        """
        self.acted = True
        start_s = self.episode.elapsed_s
        result = self.episode.execute(subtask)
        self.episode.linger(start_s)
        self.look()
        return result

    def look(self) -> None:
        """Take note of how the goal stands.

        Raises:
            AttemptOver: It is reached, or the time is up.
            Lost: It cannot be reached any more.
        """
        self.best_progress = max(self.best_progress, self.episode.progress)
        if self.episode.is_over:
            raise AttemptOver
        if self.episode.progress == 1.0:
            before = self.episode.snapshot()
            if self.finish():
                raise AttemptOver
            self.episode.restore(before)
        if not set(self.episode.fallen).isdisjoint(self.goal.entities):
            raise Lost

    def plan_alone(self) -> Plan | None:
        """Return the expert's plan for this robot alone, None where there is none."""
        return find_plan(
            self.state(),
            self.goal,
            self.grounder,
            limit_s=_UNLIMITED_S,
            team=(self.robot,),
        )

    def snapshot(self) -> EpisodeSnapshot:
        """Return the moment, to come back to it: an attacker may try things out."""
        return self.episode.snapshot()

    def restore(self, moment: EpisodeSnapshot) -> None:
        """Go back; what was done since was never done."""
        self.episode.restore(moment)

    def finish(self) -> bool:
        """Say ``stop``, and return whether the episode is a success."""
        if not self.episode.is_over:
            self.episode.stop()
        self.best_progress = max(self.best_progress, self.episode.progress)
        return self.episode.is_success

    def what_was_done(self) -> dict[str, object]:
        """Return it, for a replay."""
        done = tuple(executed.grounded for executed in self.episode.executed)
        return {"subtasks": done}


class SkillTable:
    """A compiled instance, from whose start attempts begin."""

    def __init__(self, instance: Instance) -> None:
        """Compile it."""
        self._episode = Episode(instance)
        self._start = self._episode.snapshot()

    def begin(self, robot: str, rng: np.random.Generator, attempt: int) -> SkillTrial:
        """Set the table anew; see :class:`SkillTrial`."""
        self._episode.restore(self._start)
        return SkillTrial(self._episode, robot, rng, attempt)
