"""Records of a team: what each robot was ordered, and how it ended."""

from dataclasses import dataclass

from lemma.motion.outcome import SkillResult
from lemma.planning.grounding import GroundedOption
from lemma.planning.symbolic_state import SymbolicState
from lemma.tasks.subtask import GroundedSubTask, SubTask


@dataclass(frozen=True, slots=True)
class Order:
    """A sub-task that a robot of a team carries out, or is about to."""

    subtask: SubTask | None
    """In symbols; None where only poses are known."""
    grounded: GroundedSubTask
    start_s: float
    """Simulated time at which it was given [s]."""
    option: GroundedOption | None = None
    """Its predicted effect, if that is known."""
    before: SymbolicState | None = None
    """The state in which that was predicted."""
    waits_for: frozenset[str] = frozenset()
    """Robots whose effects must come first; it begins when nobody is left."""
    own_poses: bool = False
    """Whether the poses are those of a policy, and the effect may be elsewhere."""


@dataclass(frozen=True, slots=True)
class Done:
    """An order that has come to its end."""

    robot: str
    subtask: SubTask | None
    grounded: GroundedSubTask | None
    """None where no poses were found."""
    result: SkillResult
    start_s: float
    """Simulated time at which it began or was refused [s]."""
    effect_s: float | None = None
    """When its effect was first seen, where somebody looked before its end [s]."""


@dataclass(frozen=True, slots=True)
class TeamState:
    """The state of a team beside that of its episode; plain data."""

    orders: dict[str, Order]
    rests: dict[str, float]
    effects: dict[str, float]
