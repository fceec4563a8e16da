"""A policy's own words: its reading of a sentence, and its reasons for a sub-task."""

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
"""Points of the hand, oldest first [m]."""
Paths = tuple[tuple[str, Waypoints], ...]
"""Names of robots, and paths of their hands."""

_DRAGS = (Primitive.HOOK, Primitive.POKE)
_DENIES = re.compile(
    "\\b(?:not|never|cannot|dont|nor)\\b|n['\u2019]t\\b", re.IGNORECASE
)
"""Words of denials: readers that were never shown any take them for the contrary."""
SILENT = Reading(None, "This policy does not say what it understood.")
"""Of policies without a reader."""
LEAST_CERTAIN = 0.5
"""Least certainty at which a reader has understood."""
NEAR = 0.5
"""Share of the certainty of a reading from which another one is near."""


def parse_goal(text: str, instance: Instance) -> Reading:
    """Return the goal of a sentence by the templates of the benchmark.

    Args:
        text: Anything.
        instance: Of the table.
    """
    found = parse(text)
    if found is None:
        return Reading(
            None,
            "The expert reads the sentences of the benchmark alone, and this is none "
            "of them. Choose a policy that reads, such as reachnet.",
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
        instance: Of the table.
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
            "The sentence says what shall not be, and that is not understood. Say what "
            "shall be.",
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
    """Return a reading that says so if the expert knows no way to do it.

    Args:
        reading: Of a sentence.
        scene: The table as it is.
        needed: Whether the policy cannot act without the expert's plan.
    """
    if not (reading.acts and reading.pairs):
        return reading
    now, goal = SymbolicState.observe(scene), Goal.from_pairs(reading.pairs)
    if find_plan(now, goal, GeometricGrounder(scene.spec)) is not None:
        return reading
    notes = (reading.note, "the expert knows no way to do that on this table")
    note = ", ".join(part for part in notes if part)
    return Reading(reading.pairs, note, acts=not needed)


def hear(
    text: str, instance: Instance, player: Player, *, knows: bool
) -> tuple[Instance, Reading]:
    """Return the table of an instance with another sentence.

    Args:
        text: The sentence.
        instance: Of the table.
        player: The policy.
        knows: Whether it is the expert, which knows the goal.

    Returns:
        The instance, with the goal that was understood if it can be acted on, and the
        reading.
    """
    own = text in instance.instructions.values()
    sentences = {**instance.instructions, "high_level": text}
    said = replace(instance, instructions=sentences)
    rollout = Rollout(said)
    if own and instance.goal.rule is not None:
        # No template says a rule: the expert knows it, and readers do not read it.
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
    """Return a sentence where a policy's weights are of another version; mostly none.

    Args:
        policy: Its name. Servers and visitors' hands have no weights here.
    """
    try:
        return trained_words(weights_of(PolicySpec(policy)))
    except LemmaError:
        return ""


def find_part(policy: Any, kind: Any) -> Any:
    """Return the part of a policy that is of a kind, if there is one."""
    if isinstance(policy, Composite):
        found = (find_part(part, kind) for part in policy.parts)
        return next((part for part in found if part is not None), None)
    return policy if isinstance(policy, kind) else None


def _possible(pairs: GoalPairs, instance: Instance) -> Reading:
    """Return a reading of a goal, if it can be one of this table."""
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
    grounded = decision.grounded
    waypoints = () if grounded is None else planned_path(simulation, grounded)
    now = SymbolicState.observe(simulation.scene)
    pairs = (*now.supports.items(), *now.seconds.items())
    covers = tuple((low, top) for top, low in pairs if low != TABLE)
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
    """Asks a policy, and reports its answer before it is carried out."""

    policy: Any
    tell: Callable[[Decision | Actions | None, Insight | None], None]
    """Called with each decision and its reasons, where the policy gives any; with None
    before the policy is asked."""

    @property
    def parts(self) -> tuple[object, ...]:
        """The policy."""
        return (self.policy,)

    def act(self, inputs: Sequence[Any]) -> Any:
        """Return the policy's answer, even if it makes no sense."""
        # Motor commands are asked for twenty times a second: nobody could read that.
        if not isinstance(inputs[0], ControlInput):
            self.tell(None, None)
        answers = self.policy.act(inputs)
        if isinstance(answers, list | tuple) and answers:
            decision, insight = check(answers[0], inputs[0]), None
            # The rollout turns nonsense into a fault.
            if isinstance(decision, Decision | Actions):
                explainer = find_part(self.policy, Explainer)
                if explainer is not None:
                    insight = explainer.explain(visible_to(explainer, inputs[:1]))[0]
                self.tell(decision, insight)
        return answers
