"""A policy's reading of a sentence, asked for before it acts."""

import re
from dataclasses import replace
from typing import Any

from lemma.core.errors import LemmaError
from lemma.evaluation.run.rollout import Player, Rollout
from lemma.planning.grounding import GeometricGrounder
from lemma.planning.planner import find_plan
from lemma.planning.symbolic_state import SymbolicState
from lemma.policies.interfaces import Composite, PolicyInput, Reader
from lemma.scene.scene import Scene
from lemma.tasks.goal import Goal
from lemma.tasks.instance import Instance
from lemma.tasks.language.bank import parse, phrase
from lemma.tasks.language.template import GoalPairs
from lemma.viewer.episode.status import Reading, say_goal

_DENIES = re.compile(
    "\\b(?:not|never|cannot|dont|nor)\\b|n['\u2019]t\\b", re.IGNORECASE
)
"""Words of denials, which readers take for the contrary: none was trained on them."""
SILENT = Reading(None, "This policy does not say what it understood.")
"""Of policies without a reader."""
LEAST_CERTAIN = 0.5
"""Least certainty at which a reader has understood."""


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


def ask_reader(policy: object, given: PolicyInput, instance: Instance) -> Reading:
    """Return the goal that a policy's own reader finds in a sentence.

    Args:
        policy: The policy.
        given: Its input before the first decision.
        instance: Of the table.
    """
    reader = find_reader(policy)
    if reader is None:
        return SILENT
    if _DENIES.search(given.instruction):
        return Reading(
            None,
            "The sentence says what shall not be, and that is not understood. Say what "
            "shall be.",
            acts=False,
        )
    pairs, certainty = reader.understand([given])[0]
    if certainty < LEAST_CERTAIN or not pairs:
        best = f"; at best {say_goal(pairs)}, {certainty:.0%} sure" if pairs else ""
        return Reading(None, f"The sentence could not be read{best}.", acts=False)
    found = _possible(pairs, instance)
    return Reading(found.pairs, found.note or f"{certainty:.0%} sure", found.acts)


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
    sentences = {**instance.instructions, "high_level": text}
    said = replace(instance, instructions=sentences)
    rollout = Rollout(said)
    if knows:
        reading = parse_goal(text, said)
    else:
        reading = ask_reader(player.policy, player.given(rollout), said)
    reading = check_plan(reading, rollout.episode.simulation.scene, needed=knows)
    if reading.acts and reading.pairs:
        said = replace(said, goal=Goal.from_pairs(reading.pairs))
    return said, reading


def find_reader(policy: Any) -> Reader | None:
    """Return the part of a policy that reads sentences, if there is one."""
    if isinstance(policy, Composite):
        found = (find_reader(part) for part in policy.parts)
        return next((reader for reader in found if reader is not None), None)
    return policy if isinstance(policy, Reader) else None


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
