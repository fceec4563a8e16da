"""Instances that one robot alone can solve: an audit that finds nothing there is none.

They are laid out by what an arm reaches, so that they stay soft when the benchmark's
own tables change.
"""

import math
from collections.abc import Callable
from dataclasses import replace

from lemma.core.poses import Pose2
from lemma.robots.reach import Reach, reach_of
from lemma.scene.objects.kind import ObjectKind, Part
from lemma.scene.objects.pad import PAD, PAD_RADIUS_M
from lemma.scene.objects.stick import GRASP_FROM_END_M, HANDLE_LENGTH_M
from lemma.scene.objects.tray import HANDLE_GRASP_M, TRAY, TRAY_MASS_KG
from lemma.scene.spec import ObjectPlacement, RobotPlacement, SceneSpec
from lemma.tasks.goal import Goal
from lemma.tasks.instance import Instance

ARM = "ur5"
BASE = Pose2(-1.1, 0.0, 0.0)
OTHER = Pose2(1.2, 0.0, math.pi)


def reach() -> Reach:
    return reach_of(ARM)


def at(radius_m: float, bearing_deg: float, yaw: float = 0.0) -> Pose2:
    """A position by distance and direction from the first robot."""
    bearing = math.radians(bearing_deg)
    return Pose2(
        BASE.x + radius_m * math.cos(bearing),
        BASE.y + radius_m * math.sin(bearing),
        yaw,
    )


def instance(task: str, goal: tuple[str, str], *objects: ObjectPlacement) -> Instance:
    """An instance with two robots of one kind, far apart."""
    robots = tuple(RobotPlacement(ARM, "red", base) for base in (BASE, OTHER))
    return Instance(
        task=task,
        split="free",
        index=0,
        scene=SceneSpec(robots, objects),
        goal=Goal.from_pairs((goal,)),
        instructions=dict.fromkeys(("high_level", "human", "unseen"), "Do it."),
        distractors=(),
    )


def stick_of_first(turn_deg: float = -45.0) -> ObjectPlacement:
    """The stick in the first robot's reach, pointing outwards."""
    turn = math.radians(turn_deg)
    end = at(0.55 * reach().travel_m, -45.0)
    back = GRASP_FROM_END_M
    pose = Pose2(end.x - back * math.cos(turn), end.y - back * math.sin(turn), turn)
    return ObjectPlacement("stick", "yellow", pose)


def two_cubes_to_drag() -> Instance:
    """Both cubes lie out of reach, where the stick drags them home."""
    far_m = reach().grasp_m + 0.10
    return instance(
        "poke_stack",
        ("red_cube", "blue_cube"),
        ObjectPlacement("cube", "red", at(far_m, 25.0)),
        ObjectPlacement("cube", "blue", at(far_m, 2.0)),
        stick_of_first(),
    )


def stack_out_of_reach(beyond_m: float) -> Instance:
    """A cube lies well in reach, the one to put it on so far out of grasp."""
    return instance(
        "stack",
        ("red_cube", "blue_cube"),
        ObjectPlacement("cube", "red", at(0.7 * reach().travel_m, 30.0)),
        ObjectPlacement("cube", "blue", at(reach().grasp_m + beyond_m, -10.0)),
    )


def thin_pad(name: str, radius_m: float) -> ObjectKind:
    """A pad so thin that things are pushed onto it, as in version 1."""
    thickness_m = 0.004
    size_m = (radius_m, thickness_m / 2)
    disc = Part("cylinder", size_m, position_m=(0.0, 0.0, thickness_m / 2))
    return replace(
        PAD,
        name=name,
        nouns=(name,),
        parts=(disc,),
        height_m=thickness_m,
        disc_m=radius_m,
        side_m=radius_m,
        support_m=radius_m - 0.01,
    )


def light_tray(name: str) -> ObjectKind:
    """A tray of 0.2 kg, which one hand lifts level by one handle."""
    share = 0.2 / TRAY_MASS_KG
    parts = [replace(p, mass_kg=share * (p.mass_kg or 0.0)) for p in TRAY.parts]
    return replace(TRAY, name=name, nouns=(name,), parts=tuple(parts), listed=True)


THIN = (thin_pad("mat", PAD_RADIUS_M), thin_pad("rug", 0.3), light_tray("platter"))
"""Kinds that are registered where soft tables are used."""


def pad_out_of_reach(beyond_m: float, kind: str = "pad") -> Instance:
    """Cubes and stick lie in reach, the pad so far out of grasp."""
    return instance(
        "hook",
        ("red_cube", f"blue_{kind}"),
        ObjectPlacement("cube", "red", at(0.72 * reach().travel_m, 22.0)),
        ObjectPlacement("cube", "green", at(0.55 * reach().travel_m, 50.0)),
        ObjectPlacement(kind, "blue", at(reach().grasp_m + beyond_m, 8.0)),
        stick_of_first(),
    )


def tower_to_push() -> Instance:
    """The stick points ahead, so that it need not be turned between base and tower."""
    soft = pad_out_of_reach(0.15)
    objects = (
        ObjectPlacement("cube", "red", at(0.72 * reach().travel_m, 43.0)),
        ObjectPlacement("cube", "green", at(0.55 * reach().travel_m, 68.0)),
        *(placed for placed in soft.scene.objects if placed.kind == "pad"),
        stick_of_first(0.0),
    )
    return replace(soft, scene=replace(soft.scene, objects=objects))


def stick_across() -> Instance:
    """The stick lies across the front, all of it in reach; the rug's edge does not."""
    soft = pad_out_of_reach(0.35, "rug")
    tip = at(0.62 * reach().travel_m, 35.0)
    turn = math.radians(-85.0)
    back = GRASP_FROM_END_M
    stick = Pose2(tip.x - back * math.cos(turn), tip.y - back * math.sin(turn), turn)
    objects = (
        ObjectPlacement("cube", "red", at(0.5 * reach().travel_m, 70.0)),
        *(placed for placed in soft.scene.objects if placed.kind == "rug"),
        ObjectPlacement("stick", "yellow", stick),
    )
    return replace(soft, scene=replace(soft.scene, objects=objects))


def rug_not_cleared() -> Instance:
    """A cube stands on the rug, which has room for two: it need not be cleared."""
    soft = pad_out_of_reach(0.0, "rug")
    near, far = soft.scene.robots
    robots = (near, replace(far, base=Pose2(0.1, 0.0, math.pi)))
    objects = (
        ObjectPlacement("cube", "red", at(0.72 * reach().travel_m, 22.0)),
        ObjectPlacement("cube", "green", at(0.7 * reach().travel_m, -45.0)),
        ObjectPlacement("rug", "blue", at(0.72 * reach().travel_m, -60.0)),
    )
    return replace(soft, scene=replace(soft.scene, robots=robots, objects=objects))


def stick_by_its_hook() -> Instance:
    """The end of the stick's handle is out of reach, its hook is not."""
    soft = two_cubes_to_drag()
    tip = at(0.72 * reach().travel_m, -30.0)
    turn = math.radians(165.0)
    end = Pose2(
        tip.x - HANDLE_LENGTH_M * math.cos(turn),
        tip.y - HANDLE_LENGTH_M * math.sin(turn),
        turn,
    )
    stick = ObjectPlacement("stick", "yellow", end)
    others = tuple(o for o in soft.scene.objects if o.kind != "stick")
    return replace(soft, scene=replace(soft.scene, objects=(*others, stick)))


def tray_for_one() -> Instance:
    """A light tray, whose near handle and its place are well in reach."""
    x = BASE.x + 0.6 + HANDLE_GRASP_M
    return instance(
        "carry",
        ("platter", "blue_rack"),
        ObjectPlacement("platter", "platter", Pose2(x, -0.2)),
        ObjectPlacement("rack", "blue", Pose2(x, 0.2)),
    )


def rod_for_one() -> Instance:
    """A rod, and a pad onto which a hand at its end gets it."""
    return instance(
        "give",
        ("rod", "blue_pad"),
        ObjectPlacement("rod", "rod", at(0.6, -60.0)),
        ObjectPlacement("pad", "blue", at(reach().grasp_m + 0.08, 0.0)),
    )


SOFT: dict[str, Callable[[], Instance]] = {
    "drag_home": two_cubes_to_drag,
    "drag_any_part": two_cubes_to_drag,
    "take_the_stick": stick_by_its_hook,
    "push_onto_pad": lambda: pad_out_of_reach(0.15, "mat"),
    "carry_on_stick": stick_across,
    "push_tower": tower_to_push,
    "shove": lambda: pad_out_of_reach(reach().travel_m - reach().grasp_m + 0.07, "mat"),
    "greedy_skills": lambda: pad_out_of_reach(-0.25),
    "random_skills": lambda: pad_out_of_reach(-0.25),
    "lifted_skills": lambda: stack_out_of_reach(-0.25),
    "out_of_order": rug_not_cleared,
    "one_skipped": rug_not_cleared,
    "tilted_move": lambda: stack_out_of_reach(0.05),
    "rake": lambda: stack_out_of_reach(0.05),
    "hand_push": lambda: pad_out_of_reach(0.06, "mat"),
    "tilted_stick": two_cubes_to_drag,
    "tip_off_stick": lambda: pad_out_of_reach(0.25),
    "fling": lambda: pad_out_of_reach(0.10),
    "throw": lambda: pad_out_of_reach(0.45, "rug"),
    "lob": lambda: pad_out_of_reach(0.10),
    "search": lambda: pad_out_of_reach(0.20),
    "strike": lambda: pad_out_of_reach(0.25, "mat"),
    "topple": lambda: pad_out_of_reach(0.25, "mat"),
    "cube_chain": lambda: pad_out_of_reach(0.20, "mat"),
    "stick_relay": lambda: pad_out_of_reach(0.95, "mat"),
    "tower_push": lambda: pad_out_of_reach(0.25),
    "knock_off": lambda: pad_out_of_reach(0.24),
    "one_handle": tray_for_one,
    "far_end": rod_for_one,
    "squeeze_out": lambda: pad_out_of_reach(0.20),
}
"""Attacks, and an instance that each of them solves."""

THROWS = ("fling", "throw", "lob")
"""Attacks that solve theirs only where objects may be thrown."""


def soft_table(attack: str) -> Instance:
    """The instance that an attack solves; those of :data:`THIN` must be registered."""
    return SOFT[attack]()
