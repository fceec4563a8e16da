"""A policy's reading of a sentence, and its reasons for a sub-task."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from lemma.core.errors import LemmaError
from lemma.env.simulation import Simulation
from lemma.evaluation.run.fault_isolation import check
from lemma.evaluation.run.loading import weights_of
from lemma.evaluation.run.rollout import Player, Rollout
from lemma.motion.skills import DRAG_HEIGHT_M, stand_at
from lemma.planning.grounding import GeometricGrounder
from lemma.planning.planner import find_plan
from lemma.planning.symbolic_state import TABLE, SymbolicState
from lemma.policies.control.interfaces import Actions, ControlInput
from lemma.policies.interfaces import (
    Composite,
    Decision,
    Explainer,
    Insight,
    PolicyInput,
    Reader,
    visible_to,
)
from lemma.policies.spec import PolicySpec
from lemma.policies.text.refusals import unknown_things
from lemma.robots.reach import TRAVEL_HEIGHT_M
from lemma.scene.scene import Scene
from lemma.tasks.goal import Goal
from lemma.tasks.instance import Instance
from lemma.tasks.language.bank import parse, phrase
from lemma.tasks.language.template import GoalPairs
from lemma.tasks.subtask import GroundedSubTask, Primitive
from lemma.viewer.episode.status import Reading, say_goal
from lemma.viz.recording import trained_words

Waypoints = tuple[tuple[float, float, float], ...]
"""Positions of the hand (x, y, z) in the world's frame, oldest first [m]."""
Paths = tuple[tuple[str, Waypoints], ...]
"""Names of robots and paths of their hands."""

_DRAGS = (Primitive.HOOK, Primitive.POKE)
_DENIES = re.compile(
    "\\b(?:not|never|cannot|dont|nor)\\b|n['\u2019]t\\b", re.IGNORECASE
)
"""Negations; readers trained without them would ignore them."""
SILENT = Reading(None, "This policy does not report its reading of the sentence.")
"""The reading of policies without a reader."""
LEAST_CERTAIN = 0.5
"""Least probability of a reading that counts as understood."""
NEAR = 0.5
"""Least probability of a rival reading, as a share of that of the best one."""


def parse_goal(text: str, instance: Instance) -> Reading:
    """Return the goal of a sentence from the templates of the benchmark.

    Args:
        text: Any sentence.
        instance: The instance with the table's robots and objects.
    """
    found = parse(text)
    if found is None:
        return Reading(
            None,
            "The expert understands only sentences of the benchmark, and this is none "
            "of them. Choose a policy that understands free text, such as reachnet.",
            acts=False,
        )
    return _possible(tuple(sorted(found)), instance)


def ask_reader(
    policy: object, policy_input: PolicyInput, instance: Instance
) -> Reading:
    """Return the goal that a policy's own reader finds in a sentence.

    Args:
        policy: The policy.
        policy_input: Its input before the first decision.
        instance: The instance with the table's robots and objects.
    """
    reader: Reader | None = find_part(policy, Reader)
    if reader is None:
        return SILENT
    found = reader.understand([policy_input])[0]
    pairs, certainty = found.goal, found.certainty
    if found.refusal:
        missing = unknown_things(policy_input.instruction)
        why = f"There is no {missing} here." if missing else found.refusal
        return Reading(None, f"{why} ({certainty:.0%} sure)", acts=False)
    if not found.refuses and _DENIES.search(policy_input.instruction):
        return Reading(
            None,
            "The sentence contains a negation, which is not understood. Say what shall "
            "be done.",
            acts=False,
        )
    if found.other and found.other_certainty >= NEAR * certainty:
        two = f"{say_goal(pairs)}, or {say_goal(found.other)}"
        return Reading(
            None,
            f"That can be read in two ways: {two}? Say which one.",
            acts=False,
            choices=(pairs, found.other),
        )
    if certainty < LEAST_CERTAIN or not pairs:
        best = f"; at best {say_goal(pairs)}, {certainty:.0%} sure" if pairs else ""
        return Reading(None, f"The sentence could not be read{best}.", acts=False)
    said = _possible(pairs, instance)
    return Reading(said.pairs, said.note or f"{certainty:.0%} sure", said.acts)


def check_plan(reading: Reading, scene: Scene, *, needed: bool) -> Reading:
    """Return a reading with a note if the expert finds no plan for it.

    Args:
        reading: The reading of a sentence.
        scene: The scene in its present state.
        needed: Whether the policy cannot act without the expert's plan.
    """
    if not (reading.acts and reading.pairs):
        return reading
    now, goal = SymbolicState.observe(scene), Goal.from_pairs(reading.pairs)
    if find_plan(now, goal, GeometricGrounder(scene.spec)) is not None:
        return reading
    notes = (reading.note, "the expert finds no plan for that on this table")
    note = ", ".join(part for part in notes if part)
    return Reading(reading.pairs, note, acts=not needed)


def hear(
    text: str, instance: Instance, player: Player, *, knows: bool
) -> tuple[Instance, Reading]:
    """Return an instance with another sentence.

    Args:
        text: The sentence.
        instance: The instance with the table's robots and objects.
        player: The policy.
        knows: Whether the policy is the expert, which has the goal.

    Returns:
        The instance, with the goal of the reading if the policy can act on it, and the
        reading.
    """
    own = text in instance.instructions.values()
    sentences = {**instance.instructions, "high_level": text}
    said = replace(instance, instructions=sentences)
    rollout = Rollout(said)
    if own and instance.goal.rule is not None:
        # Templates have no rules: the expert has them, readers cannot read them.
        return said, Reading(instance.goal.pairs) if knows else SILENT
    if knows:
        reading = parse_goal(text, said)
    else:
        reading = ask_reader(player.policy, player.policy_input(rollout), said)
    reading = check_plan(reading, rollout.episode.simulation.scene, needed=knows)
    if reading.acts and reading.pairs:
        said = replace(said, goal=Goal.from_pairs(reading.pairs))
    return said, reading


def weights_words(policy: str) -> str:
    """Return a sentence if a policy's weights are of another version, else ``""``.

    Args:
        policy: Its name. Servers and teleoperation have no weights here.
    """
    try:
        return trained_words(weights_of(PolicySpec(policy)))
    except LemmaError:
        return ""


def find_part(policy: Any, kind: Any) -> Any:
    """Return the first part of a policy that is of a class; None without one."""
    if isinstance(policy, Composite):
        found = (find_part(part, kind) for part in policy.parts)
        return next((part for part in found if part is not None), None)
    return policy if isinstance(policy, kind) else None


def _possible(pairs: GoalPairs, instance: Instance) -> Reading:
    """Return a reading of a goal; it does not act if the table lacks an object."""
    names = instance.scene.object_names
    absent = [name for pair in pairs for name in pair if name not in names]
    if absent:
        missing = " and no ".join(dict.fromkeys(map(phrase, absent)))
        return Reading(pairs, f"There is no {missing} on this table.", acts=False)
    try:
        Goal.from_pairs(pairs)
    except LemmaError as error:
        return Reading(pairs, str(error), acts=False)
    return Reading(pairs)


@dataclass(frozen=True, slots=True)
class Explanation:
    """Reasons and path of a sub-task."""

    time_s: float
    """Simulated time [s]."""
    insight: Insight | None = None
    """The policy's perception and options; None if it reports none."""
    robot: str = ""
    """Name of the robot that acts."""
    waypoints: Waypoints = ()
    """Path of its hand, in the world's frame [m]."""
    covers: tuple[tuple[str, str], ...] = ()
    """Pairs (lower, upper) of objects that lie on each other."""


NOTHING = Explanation(0.0)


def explain(
    simulation: Simulation, time_s: float, decision: Decision, insight: Insight | None
) -> Explanation:
    """Return reasons and path of the next sub-task.

    Args:
        simulation: The simulation before the sub-task.
        time_s: Simulated time of the episode [s].
        decision: The policy's decision.
        insight: The policy's reasons; None if it reports none.
    """
    grounded = decision.grounded
    waypoints = () if grounded is None else planned_path(simulation, grounded)
    now = SymbolicState.observe(simulation.scene)
    pairs = (*now.supports.items(), *now.seconds.items())
    covers = tuple((low, top) for top, low in pairs if low != TABLE)
    return Explanation(time_s, insight, decision.subtask.robot, waypoints, covers)


def planned_path(simulation: Simulation, grounded: GroundedSubTask) -> Waypoints:
    """Return the straight path of a hand from its present pose to pick and place.

    The real path differs where the arm avoids obstacles.

    Args:
        simulation: The simulation before the sub-task.
        grounded: The sub-task.

    Returns:
        Positions in the world's frame [m]; empty if the scene lacks the robot.
    """
    arm = simulation.arms.get(grounded.robot)
    if arm is None:
        return ()
    high, low = TRAVEL_HEIGHT_M, DRAG_HEIGHT_M
    pick, place = grounded.pick, grounded.place
    stops = [(pick, high), (pick, low), (pick, high), (place, high), (place, low)]
    if grounded.primitive in _DRAGS:
        stops = [(pick, high), (pick, low), (place, low)]
    x, y, z = arm.tcp_pose()[:3, 3].tolist()
    stands = [stand_at(pose, height_m) for pose, height_m in stops]
    return ((x, y, z), *((stand[0], stand[1], stand[2]) for stand in stands))


@dataclass(frozen=True)
class ObservedPolicy(Composite):
    """Calls a policy, and reports its decision before the execution."""

    policy: Any
    tell: Callable[[Decision | Actions | None, Insight | None], None]
    """Called with each decision and its reasons (None if the policy reports none), and
    with (None, None) before the policy is called."""

    @property
    def parts(self) -> tuple[object, ...]:
        """The observed policy."""
        return (self.policy,)

    def act(self, inputs: Sequence[Any]) -> Any:
        """Return the policy's answer, valid or not."""
        # Motor commands come 20 times a second, too often for reports.
        if not isinstance(inputs[0], ControlInput):
            self.tell(None, None)
        answers = self.policy.act(inputs)
        if isinstance(answers, list | tuple) and answers:
            decision, insight = check(answers[0], inputs[0]), None
            # The rollout turns an invalid answer into a fault.
            if isinstance(decision, Decision | Actions):
                explainer = find_part(self.policy, Explainer)
                if explainer is not None:
                    insight = explainer.explain(visible_to(explainer, inputs[:1]))[0]
                self.tell(decision, insight)
        return answers
