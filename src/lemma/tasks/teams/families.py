"""The families of the suite ``teams``: tasks of several robots."""

from lemma.core.robot_names import robot_name
from lemma.scene.objects.entity import entity_named
from lemma.tasks.goal import Goal, On
from lemma.tasks.library import task
from lemma.tasks.placement import ObjectPlacer
from lemma.tasks.teams.rule import After, But, Without

OF_THREE = (
    ("ur5",) * 3,
    ("ur5", "ur5", "ur10"),
    ("ur5", "ur10", "ur10"),
    ("ur10",) * 3,
)


@task(
    "relay",
    "A cube goes from hand to hand along three robots, onto its pad.",
    subtasks=3,
    distractors=(1, 4),
    layout="chain",
    teams=(("ur5", "ur5", "ur5"), ("ur5", "ur10", "ur5"), ("ur5", "ur5", "ur10")),
)
def arrange_relay(placer: ObjectPlacer) -> Goal:
    """The cube is at one end, its pad at the other; the ends share nothing."""
    first, *_, last = placer.order
    cube = placer.cube(placer.only(first))
    pad = placer.pad(placer.only(last))
    return Goal((On(cube, pad),))


@task(
    "line",
    "Two cubes go through three robots in a row, onto their pads.",
    subtasks=6,
    distractors=(0, 3),
    layout="row",
    teams=(("ur5", "ur5", "ur5"),),
)
def arrange_line(placer: ObjectPlacer) -> Goal:
    """Cubes are at one end, their pads at the other; the ends share nothing."""
    first, *_, last = placer.order
    pads = [placer.pad(placer.only(last)) for _ in range(2)]
    cubes = [placer.cube(placer.only(first)) for _ in range(2)]
    return Goal(tuple(map(On, cubes, pads)))


@task(
    "carousel",
    "Each of four robots passes its cube on to the next, onto its pad.",
    subtasks=8,
    distractors=(0, 1),
    layout="square",
    teams=(("ur5",) * 4, ("ur5", "ur10", "ur5", "ur10")),
)
def arrange_carousel(placer: ObjectPlacer) -> Goal:
    """Each robot has a cube, whose pad is with the next one around the square."""
    order = placer.order
    cubes = [placer.cube(placer.only(robot)) for robot in order]
    pads = [placer.pad(placer.only(robot)) for robot in (*order[1:], order[0])]
    return Goal(tuple(map(On, cubes, pads)))


@task(
    "sort",
    "Each of three cubes goes to the robot of its color, onto its mat.",
    subtasks=5,
    distractors=(0, 2),
    layout="triangle",
    teams=OF_THREE,
)
def arrange_sort(placer: ObjectPlacer) -> Goal:
    """One robot has the cube of its color; two have each other's."""
    robots = placer.robots
    colors = [robots[robot].color for robot in placer.order]
    where = (placer.order[0], placer.order[2], placer.order[1])
    cubes, pads = [], []
    for color, owner, robot in zip(colors, where, placer.order, strict=True):
        cubes.append(placer.cube(placer.only(owner), color))
        pads.append(placer.pad(placer.only(robot), color))
    return Goal(tuple(map(On, cubes, pads)))


@task(
    "tower",
    "Three robots bring a cube each to a tower that one of them builds.",
    subtasks=5,
    distractors=(0, 2),
    layout="triangle",
    teams=OF_THREE,
)
def arrange_tower(placer: ObjectPlacer) -> Goal:
    """The first robot has the pad and the lowest cube, the others one cube each."""
    builder = placer.order[0]
    pad = placer.pad(placer.only(builder))
    low, middle, high = (placer.cube(placer.only(robot)) for robot in placer.order)
    return Goal((On(low, pad), On(middle, low), On(high, middle)))


@task(
    "exchange",
    "Cubes go to their pads under a rule: only after, without a robot, all but one.",
    subtasks=3,
    distractors=(0, 1),
    layout="triangle",
    teams=OF_THREE,
    rules=(After.kind, Without.kind, But.kind),
)
def arrange_exchange(placer: ObjectPlacer) -> Goal:
    """A rule takes away one of two ways; nothing but the sentence tells which."""
    one, other, third = placer.order
    chosen = int(placer.rng.integers(2))
    if placer.rule == Without.kind:
        # Either could bring one of the cubes alone, and the other one to the third.
        both = placer.only(one, other)
        pads = [placer.pad(placer.only(robot, third)) for robot in (one, other)]
        cubes = [placer.cube(both) for _ in pads]
        rule = Without(robot_name((one, other)[chosen]))
        return Goal(tuple(map(On, cubes, pads)), rule)
    if placer.rule == But.kind:
        # Two have each other's cubes, of which one stays. Colors say what belongs.
        pads = [placer.pad(placer.only(robot)) for robot in (one, other, third)]
        colors = [entity_named(pad).color for pad in pads]
        zones = map(placer.only, (other, one, third))
        cubes = [placer.cube(*there) for there in zip(zones, colors, strict=True)]
        moved = (1 - chosen, 2)
        goes = tuple(On(cubes[k], pads[k]) for k in moved)
        return Goal(goes, But(cubes[chosen]))
    cubes = [placer.cube(placer.only(robot)) for robot in (one, third)]
    pads = [placer.pad(placer.only(robot)) for robot in (other, third)]
    pairs = list(zip(cubes, pads, strict=True))
    after = After(*pairs[chosen], *pairs[1 - chosen])
    return Goal(tuple(map(On, cubes, pads)), after)
