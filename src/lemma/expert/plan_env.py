"""The plan level: one symbolic sub-task per step, which the oracle grounds."""

from typing import Any

from lemma.env.action_spaces import Action, decode_plan, encode_plan, plan_space
from lemma.env.config import EnvConfig
from lemma.env.episode import Episode
from lemma.env.skill_env import SubTaskEnv
from lemma.expert.grounding import GeometricGrounder
from lemma.expert.symbolic_state import SymbolicState
from lemma.motion.outcome import Outcome, SkillResult
from lemma.scene.spec import SHARED, STICK
from lemma.tasks.subtask import Primitive, SubTask

_TOOL = {
    Primitive.HOOK: Primitive.PREHOOK,
    Primitive.POKE: Primitive.PREPOKE,
}
"""What must come before a primitive."""


class PlanEnv(SubTaskEnv):
    """An action is who does what with which object and where: names, no geometry."""

    def __init__(self, config: EnvConfig, render_mode: str | None = None) -> None:
        """Define the spaces; nothing is simulated before the first reset.

        Args:
            config: The options.
            render_mode: ``"rgb_array"`` for :meth:`render`, or None.
        """
        super().__init__(config, render_mode)
        self.action_space = plan_space(len(self.robot_names))
        self._grounder: GeometricGrounder | None = None

    def _begin(self, episode: Episode) -> None:
        super()._begin(episode)
        self._grounder = GeometricGrounder(episode.simulation.scene.spec)

    def encode(self, subtask: SubTask) -> dict[str, Any]:
        """Return the action for a sub-task.

        Raises:
            InvalidActionError: There never is such an entity.
        """
        return encode_plan(subtask)

    def decode(self, action: Action) -> SubTask:
        """Return the sub-task that an action means.

        Raises:
            InvalidActionError: The action is not in the space.
        """
        return decode_plan(action, len(self.robot_names))

    def _execute(self, action: Action) -> SkillResult:
        subtask = self.decode(action)
        if subtask.primitive is Primitive.STOP:
            return self.episode.stop()
        assert self._grounder is not None
        now = SymbolicState.observe(self.episode.simulation.scene)
        refusal = _why_senseless(subtask, now)
        if refusal is not None:
            return SkillResult(Outcome.INVALID, refusal, 0.0)
        step = self._grounder.ground(subtask, now)
        if step is None:
            return _explain(subtask, now, self._grounder)
        return self.episode.execute(step.grounded)


def _why_senseless(subtask: SubTask, now: SymbolicState) -> str | None:
    """Return why nobody could do a sub-task, None if somebody might."""
    pick, place, primitive = subtask.pick, subtask.place, subtask.primitive
    for name in (pick, place):
        if name == "":
            return f"{primitive} needs something to pick and a place."
        if name != SHARED and name not in now.poses:
            return f"There is no {name} on this table, only {', '.join(now.poses)}."
    if primitive is not Primitive.MOVE:
        if pick != STICK:
            return f"{primitive} is done with the stick, not with the {pick}."
        if place not in now.supports:
            return f"{primitive} acts on a cube, not on {place}."
        before = _TOOL.get(primitive)
        if before is not None and not now.is_prepared(primitive, place):
            return f"The stick does not lie ready for {place}: {before} comes first."
        return None
    if pick == STICK:
        return None if place == SHARED else f"The stick cannot be put on {place}."
    if pick not in now.supports:
        return f"The {pick} is fixed to the table."
    if place in (pick, STICK):
        return f"The {pick} cannot be put on {place}."
    for name in (pick, place):
        above = None if name == SHARED else now.on_top_of(name)
        if above is not None and above != pick:
            return f"The {above} lies on the {name}."
    return f"The {pick} lies there already." if now.supports[pick] == place else None


def _explain(
    subtask: SubTask, now: SymbolicState, grounder: GeometricGrounder
) -> SkillResult:
    """Return the result of a sub-task that makes sense but found no grounding."""
    robot = subtask.robot
    arm = grounder.robots[robot].arm
    for name in (subtask.pick, subtask.place):
        if subtask.primitive is not Primitive.MOVE or name in (SHARED, STICK):
            continue
        if not grounder.reaches(robot, now.poses[name]):
            return SkillResult(
                Outcome.UNREACHABLE, f"{robot} ({arm}) cannot reach the {name}.", 0.0
            )
    return SkillResult(
        Outcome.UNREACHABLE,
        f"{robot} ({arm}) finds no way to {subtask.primitive} the {subtask.pick} "
        f"for {subtask.place}: it is too far, or something is in the way.",
        0.0,
    )
