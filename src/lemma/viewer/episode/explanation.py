"""Why and how a sub-task is done: the policy's reasons, and the path of the hand."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from lemma.env.simulation import Simulation
from lemma.evaluation.run.fault_isolation import Fault, check
from lemma.motion.skills import DRAG_HEIGHT_M, stand_at
from lemma.planning.symbolic_state import TABLE, SymbolicState
from lemma.policies.control.interfaces import Actions, ControlInput
from lemma.policies.interfaces import Composite, Decision, Explainer, Insight, told
from lemma.robots.reach import TRAVEL_HEIGHT_M
from lemma.tasks.subtask import GroundedSubTask, Primitive

Waypoints = tuple[tuple[float, float, float], ...]
"""Points of the hand, oldest first [m]."""

_DRAGS = (Primitive.HOOK, Primitive.POKE)


@dataclass(frozen=True, slots=True)
class Explanation:
    """Why a sub-task is done, and how."""

    time_s: float
    """Simulated time [s]."""
    insight: Insight | None = None
    """The policy's perception and options; None where it gives none."""
    robot: str = ""
    """Name of the robot that acts."""
    waypoints: Waypoints = ()
    """Path of its hand [m]."""
    covers: tuple[tuple[str, str], ...] = ()
    """Pairs (lower, upper) of things that lie on each other."""


NOTHING = Explanation(0.0)


def explain(
    simulation: Simulation, time_s: float, decision: Decision, insight: Insight | None
) -> Explanation:
    """Return why and how a sub-task is about to be done.

    Args:
        simulation: As it is before the sub-task.
        time_s: Simulated time of the episode [s].
        decision: Of the policy.
        insight: The policy's reasons, if it gives any.
    """
    waypoints: Waypoints = ()
    if decision.grounded is not None:
        waypoints = planned_path(simulation, decision.grounded)
    supports = SymbolicState.observe(simulation.scene).supports
    covers = tuple((low, top) for top, low in supports.items() if low != TABLE)
    return Explanation(time_s, insight, decision.subtask.robot, waypoints, covers)


def planned_path(simulation: Simulation, grounded: GroundedSubTask) -> Waypoints:
    """Return the path of a hand from where it is now: over, down, and on.

    An arm keeps away from obstacles, so it goes beside these lines where it must.

    Args:
        simulation: As it is before the sub-task.
        grounded: The sub-task; the path of a robot that is not there is empty.
    """
    arm = simulation.arms.get(grounded.robot)
    if arm is None:
        return ()
    x, y, z = arm.tcp_pose()[:3, 3].tolist()
    pick, place = grounded.pick, grounded.place
    drags = grounded.primitive in _DRAGS
    low = DRAG_HEIGHT_M
    stands = [
        stand_at(pick, TRAVEL_HEIGHT_M),
        stand_at(pick, low),
        *([] if drags else [stand_at(pick, TRAVEL_HEIGHT_M)]),
        *([] if drags else [stand_at(place, TRAVEL_HEIGHT_M)]),
        stand_at(place, low),
    ]
    return ((x, y, z), *((stand[0], stand[1], stand[2]) for stand in stands))


@dataclass(frozen=True)
class ObservedPolicy(Composite):
    """Asks a policy, and reports its answer before it is carried out."""

    policy: Any
    tell: Callable[[Decision | Actions | None], None]
    """Called with each decision, and with None before the policy is asked."""
    explain: Callable[[Insight], None]
    """Called with the policy's reasons, where it gives any."""

    @property
    def parts(self) -> tuple[object, ...]:
        """The policy."""
        return (self.policy,)

    def act(self, inputs: Sequence[Any]) -> Any:
        """Return the policy's answer, even if it makes no sense."""
        # Motor commands are asked for twenty times a second: nobody could read that.
        if not isinstance(inputs[0], ControlInput):
            self.tell(None)
        answers = self.policy.act(inputs)
        if isinstance(answers, list | tuple) and answers:
            decision = check(answers[0], inputs[0])
            # The rollout turns nonsense into a fault.
            if not isinstance(decision, Fault):
                explainer = find_explainer(self.policy)
                if explainer is not None:
                    self.explain(explainer.explain(told(explainer, inputs[:1]))[0])
                self.tell(decision)
        return answers


def find_explainer(policy: Any) -> Explainer | None:
    """Return the part of a policy that gives reasons, if there is one."""
    if isinstance(policy, Composite):
        found = (find_explainer(part) for part in policy.parts)
        return next((each for each in found if each is not None), None)
    return policy if isinstance(policy, Explainer) else None
