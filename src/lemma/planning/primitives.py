"""Primitives: one record each, with skill, grounding, candidates and language.

The paper's six come first, in the order of their numbers in action spaces and trained
weights, then ``reach`` and ``lift`` of the ladder, ``carry`` and ``give`` of two
robots, then those of users.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

from lemma.core.errors import InvalidConfigError
from lemma.core.poses import Pose2
from lemma.core.registry import Registry
from lemma.motion.skills import SKILLS, SkillMotion
from lemma.planning.carrying import ground_carry
from lemma.planning.geometry import GroundedOption, SceneGeometry
from lemma.planning.giving import ground_give
from lemma.planning.symbolic_state import TABLE, SymbolicState, across_label
from lemma.planning.validity import (
    WhyNot,
    unless_prepared,
    why_not_carry,
    why_not_give,
    why_not_hand,
    why_not_move,
)
from lemma.scene.objects.cube import CUBE
from lemma.scene.objects.entity import HAND, STICK, is_carried, kind_of
from lemma.tasks.drags import (
    grasp_on_stick,
    stick_discs,
    stick_in_grasp,
    withdrawn,
)
from lemma.tasks.subtask import GroundedSubTask, Primitive, SubTask, add_primitive

_DRAG_M_S = 0.2


@dataclass(frozen=True)
class Wish:
    """An object that the planner considers moving."""

    item: str
    """The object: a cube, or the stick."""
    places: tuple[str, ...]
    """Candidate places: entities, or regions such as ``"shared"``. If empty, it must
    only leave its present place."""
    able: tuple[str, ...]
    """Robots that can grasp it at its present pose."""


Ground = Callable[[SceneGeometry, SubTask, SymbolicState], GroundedOption | None]
"""Returns a grounded sub-task with its effect, or None if its robot cannot do it."""
Candidates = Callable[[str, Wish, SymbolicState], Iterable[SubTask]]
"""Returns sub-tasks by which a robot might fulfil a wish."""


@dataclass(frozen=True, kw_only=True)
class PrimitiveSpec:
    """One primitive: its name, language and functions."""

    name: str
    """A lower-case word, such as ``"push"``."""
    phrase: str
    """Sub-instruction with slots ``{robot}``, ``{pick}`` and ``{place}``."""
    skill: SkillMotion | None = None
    """Executes it: a generator that yields once per servo tick. None for ``stop``
    alone."""
    ground: Ground = lambda geometry, subtask, now: None
    """Grounds it, for plan level and the expert. The default finds no poses, so that
    the primitive is available at skill level only."""
    candidates: Candidates = lambda robot, wish, now: ()
    """Proposes sub-tasks to the planner; the default proposes none."""
    why_not: WhyNot = lambda subtask, now: None
    """Returns why a sub-task is invalid. The check that its entities exist is done
    before."""
    tool: bool = False
    """Whether it uses the stick: ``pick`` is the stick, ``place`` the cube that it acts
    on."""


def _share(name: str, spec: PrimitiveSpec) -> None:
    """Register name, phrase and skill of a primitive in the layers below."""
    if name in tuple(Primitive):
        return
    if spec.skill is None:
        raise InvalidConfigError(
            f"Primitive {name!r} has no skill, so nothing can carry it out."
        )
    add_primitive(name, spec.phrase)
    SKILLS.add(name, spec.skill, replace=True)


PRIMITIVES: Registry[PrimitiveSpec] = Registry(
    "primitive", PrimitiveSpec, on_add=_share
)
"""All primitives, in the order of their numbers."""


def ground_move(
    geometry: SceneGeometry, subtask: SubTask, now: SymbolicState
) -> GroundedOption | None:
    """Ground ``move`` of a cube to an entity or a region, or of the stick to a region.

    Args:
        geometry: Geometry of the scene.
        subtask: The sub-task.
        now: The present state.

    Returns:
        The grounding, or None if the robot cannot do it.
    """
    if subtask.pick == STICK:
        return _ground_pass_stick(geometry, subtask, now)
    cube = subtask.pick
    if cube not in now.supports or now.on_top_of(cube) is not None:
        return None
    start, kind, robot = now.poses[cube], kind_of(cube), subtask.robot
    second: str | None = None
    if not geometry.reaches(robot, start) or geometry.overload(robot, cube):
        return None
    if subtask.place in geometry.regions:
        obstacles = geometry.discs(now, but=cube)
        if STICK in now.poses:
            obstacles += stick_discs(now.poses[STICK])
        region = geometry.regions[subtask.place]
        spot = region.free_spot(obstacles, kind.disc_m - CUBE.disc_m)
        if spot is None:
            return None
        target, support, label = spot, TABLE, subtask.place
    elif kind.span_m is not None:
        across = now.across(cube, subtask.place)
        if across is None:
            return None
        target, support, second = across
        label = across_label(support, second)
    elif subtask.place in now.poses and subtask.place != cube:
        if now.on_top_of(subtask.place) is not None:
            return None
        target, support = now.poses[subtask.place], subtask.place
        label = f"on {support}"
    else:
        return None
    if geometry.margin(subtask.robot, start, target) <= 0.0:
        return None
    pick = geometry.grasp(subtask.robot, cube, now)
    if pick is None:
        return None
    bearings = [geometry.bearing(subtask.robot, pose) for pose in (start, target)]
    yaw = pick.yaw + (bearings[1] - bearings[0])
    if second is not None:
        yaw = target.yaw + math.pi * round((yaw - target.yaw) / math.pi)
    elif support != TABLE and kind.faceted and kind_of(support).faceted:
        # Align the faces: the yaw differs from the lower cube's by quarter turns.
        yaw = target.yaw + 0.5 * math.pi * round((yaw - target.yaw) * 2 / math.pi)
    place = Pose2(target.x, target.y, yaw)
    resting = Pose2(target.x, target.y, start.yaw + yaw - pick.yaw)
    after = now.moved(cube, resting, support, label, second)
    return _option(geometry, subtask, (pick, place), after, start, target)


def _option(
    geometry: SceneGeometry,
    subtask: SubTask,
    poses: tuple[Pose2, Pose2],
    after: SymbolicState,
    *reached: Pose2,
) -> GroundedOption:
    """Return an option with pick and place poses, and the quality of ``reached``."""
    pick, place = poses
    return GroundedOption(
        subtask,
        GroundedSubTask(subtask.robot, subtask.primitive, pick, place),
        after,
        geometry.quality(subtask.robot, *reached),
        geometry.duration_s(subtask.robot, pick, place),
    )


def _ground_pass_stick(
    geometry: SceneGeometry, subtask: SubTask, now: SymbolicState
) -> GroundedOption | None:
    if subtask.place not in geometry.regions:
        return None
    pick = grasp_on_stick(now.poses[STICK])
    place = geometry.regions[subtask.place].free_stick(
        geometry.discs(now, but=STICK), geometry.robots[subtask.robot].base, pick
    )
    if place is None or geometry.margin(subtask.robot, pick, place) <= 0.0:
        return None
    after = now.moved(STICK, stick_in_grasp(place), TABLE, subtask.place)
    return _option(geometry, subtask, (pick, place), after, pick, place)


def ground_hand(
    geometry: SceneGeometry, subtask: SubTask, now: SymbolicState
) -> GroundedOption | None:
    """Ground ``reach`` or ``lift``: both poses are the grasp.

    Arguments and result are those of :func:`ground_move`.
    """
    item, lifts = subtask.pick, subtask.primitive is Primitive.LIFT
    if now.on_top_of(item) is not None or geometry.margin(
        subtask.robot, now.poses[item]
    ) <= (0.0):
        return None
    if lifts and geometry.overload(subtask.robot, item):
        return None
    pick = geometry.grasp(subtask.robot, item, now)
    if pick is None:
        return None
    pair = {item: HAND} if lifts else {HAND: item}
    label = {item: HAND} if lifts else {HAND: f"over {item}"}
    after = replace(
        now, supports={**now.supports, **pair}, labels={**now.labels, **label}
    )
    return _option(geometry, subtask, (pick, pick), after, pick)


def ground_prepare(
    geometry: SceneGeometry, subtask: SubTask, now: SymbolicState
) -> GroundedOption | None:
    """Ground ``prehook`` or ``prepoke``, which put the stick where it will be used.

    Arguments and result are those of :func:`ground_move`.
    """
    drag = geometry.drag(subtask, now)
    pick = grasp_on_stick(now.poses[STICK])
    if drag is None or not geometry.reaches(subtask.robot, pick):
        return None
    label = f"{subtask.primitive} {subtask.place} {subtask.robot}"
    after = now.moved(STICK, stick_in_grasp(drag.prepared), TABLE, label)
    return _option(geometry, subtask, (pick, drag.prepared), after, pick)


def ground_drag(
    geometry: SceneGeometry, subtask: SubTask, now: SymbolicState
) -> GroundedOption | None:
    """Ground ``hook`` or ``poke``, which pull or push the prepared stick.

    Arguments and result are those of :func:`ground_move`.
    """
    pick = grasp_on_stick(now.poses[STICK])
    if not now.is_prepared(subtask.primitive, subtask.place):
        return None
    drag = geometry.drag(subtask, now)
    if drag is None or not geometry.reaches(subtask.robot, pick):
        return None
    # Along the actual direction of the stick, which may deviate by millimetres.
    length = drag.prepared.distance(drag.end)
    sign = 1.0 if subtask.primitive is Primitive.POKE else -1.0
    end = pick @ Pose2(sign * length, 0.0)
    left = withdrawn(subtask.primitive, geometry.robots[subtask.robot], end)
    after = now.moved(
        subtask.place, drag.cube, TABLE, f"{subtask.primitive} {subtask.robot}"
    ).moved(STICK, stick_in_grasp(left), TABLE, f"used {subtask.place}")
    found = _option(geometry, subtask, (pick, end), after, pick)
    # The motion from pick to end is the drag; it has its own speed.
    handling_s = geometry.duration_s(subtask.robot, pick, pick)
    return replace(
        found,
        duration_s=handling_s + length / _DRAG_M_S,
        reluctance_s=found.duration_s - handling_s,
    )


def _propose_move(robot: str, wish: Wish, now: SymbolicState) -> Iterator[SubTask]:
    if wish.item == STICK or robot in wish.able:
        for place in wish.places:
            yield SubTask(robot, Primitive.MOVE, wish.item, place)


def _has_two_ends(name: str) -> bool:
    return kind_of(name).ends is not None


def _propose_joint(primitive: Primitive, fits: Callable[[str], bool]) -> Candidates:
    """Return a function that proposes a joint sub-task to any robot.

    Args:
        primitive: The primitive.
        fits: Whether it is for an object.
    """

    def propose(robot: str, wish: Wish, now: SymbolicState) -> Iterator[SubTask]:
        if fits(wish.item):
            for place in wish.places:
                yield SubTask(robot, primitive, wish.item, place)

    return propose


def _propose_hand(primitive: Primitive) -> Candidates:
    """Return a function that proposes ``reach`` or ``lift`` of the wish's object."""

    def propose(robot: str, wish: Wish, now: SymbolicState) -> Iterator[SubTask]:
        if HAND in wish.places and robot in wish.able:
            yield SubTask(robot, primitive, wish.item, wish.item)

    return propose


def _propose_tool(primitive: Primitive, use: Primitive) -> Candidates:
    """Return a function that proposes to use the stick, or to prepare it.

    It proposes them for objects that no robot can grasp at their present poses.
    """

    def propose(robot: str, wish: Wish, now: SymbolicState) -> Iterator[SubTask]:
        if wish.able or now.supports.get(wish.item) != TABLE or STICK not in now.poses:
            return
        if now.is_prepared(use, wish.item) == (primitive is use):
            yield SubTask(robot, primitive, STICK, wish.item)

    return propose


PRIMITIVES.add(
    Primitive.MOVE,
    PrimitiveSpec(
        name=Primitive.MOVE,
        phrase="{robot}: move the {pick} onto the {place}",
        skill=SKILLS[Primitive.MOVE],
        ground=ground_move,
        candidates=_propose_move,
        why_not=why_not_move,
    ),
)
for _prepare, _where, _use in (
    (Primitive.PREHOOK, "behind", Primitive.HOOK),
    (Primitive.PREPOKE, "in front of", Primitive.POKE),
):
    PRIMITIVES.add(
        _prepare,
        PrimitiveSpec(
            name=_prepare,
            phrase=f"{{robot}}: put the {{pick}} {_where} the {{place}}",
            skill=SKILLS[_prepare],
            ground=ground_prepare,
            candidates=_propose_tool(_prepare, _use),
            tool=True,
        ),
    )
    PRIMITIVES.add(
        _use,
        PrimitiveSpec(
            name=_use,
            phrase=f"{{robot}}: {_use} the {{place}} with the {{pick}}",
            skill=SKILLS[_use],
            ground=ground_drag,
            candidates=_propose_tool(_use, _use),
            why_not=unless_prepared(_prepare),
            tool=True,
        ),
    )
PRIMITIVES.add(Primitive.STOP, PrimitiveSpec(name=Primitive.STOP, phrase="done"))
for _hand, _phrase in (
    (Primitive.REACH, "hold the hand over the {pick}"),
    (Primitive.LIFT, "lift the {pick}"),
):
    PRIMITIVES.add(
        _hand,
        PrimitiveSpec(
            name=_hand,
            phrase=f"{{robot}}: {_phrase}",
            skill=SKILLS[_hand],
            ground=ground_hand,
            candidates=_propose_hand(_hand),
            why_not=why_not_hand,
        ),
    )
for _joint, _phrase, _fits, _ground, _why_not in (
    (
        Primitive.CARRY,
        "carry the {pick} onto the {place} with your partner",
        is_carried,
        ground_carry,
        why_not_carry,
    ),
    (
        Primitive.GIVE,
        "give the {pick} to your partner, who puts it onto the {place}",
        _has_two_ends,
        ground_give,
        why_not_give,
    ),
):
    PRIMITIVES.add(
        _joint,
        PrimitiveSpec(
            name=_joint,
            phrase=f"{{robot}}: {_phrase}",
            skill=SKILLS[_joint],
            ground=_ground,
            candidates=_propose_joint(_joint, _fits),
            why_not=_why_not,
        ),
    )
