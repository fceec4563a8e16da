"""Kinds of objects and entities: what may be registered, and how it is named."""

import math
from collections.abc import Iterator

import pytest
from own_plugins import loaded

from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.core.poses import Pose2
from lemma.robots.gripper import FINGER_OPENING_M, PALM_ABOVE_TCP_M
from lemma.scene.objects.cube import CUBE
from lemma.scene.objects.entity import (
    ENTITIES,
    STICK,
    Entity,
    entity_named,
    extra_entities,
    kind_of,
    known_entities,
)
from lemma.scene.objects.kind import (
    OBJECT_KINDS,
    Grasp,
    ObjectKind,
    Part,
    Shell,
    box,
    cylinder,
)
from lemma.scene.objects.pad import PAD
from lemma.scene.objects.palette import OBJECT_COLORS
from lemma.scene.objects.stick import STICK_KIND
from lemma.scene.scene import Scene
from lemma.scene.spec import ObjectPlacement, SceneSpec


@pytest.fixture(autouse=True)
def _registries() -> Iterator[None]:
    with loaded():
        yield


def test_numbers_of_the_benchmark_are_what_weights_were_trained_with() -> None:
    colors = ("pink", "red", "white", "blue", "green")
    cubes = tuple(f"{color}_cube" for color in colors)
    pads = tuple(f"{color}_pad" for color in colors)
    assert (*cubes, *pads, "stick") == ENTITIES
    assert tuple(entity_named(name).name for name in ENTITIES) == ENTITIES
    assert known_entities() == ENTITIES
    assert extra_entities() == ()


def test_an_entity_is_a_color_and_a_kind() -> None:
    assert entity_named("red_pad") == Entity("red", PAD)
    assert entity_named("stick") == Entity("", STICK_KIND)
    assert entity_named("stick").phrase == "yellow stick"
    assert kind_of("blue_cube") is CUBE


@pytest.mark.parametrize(
    "name", ["", "cube", "red", "_stick", "red_stick", "rad_cube", "red_ball", "table"]
)
def test_what_is_no_entity_is_answered(name: str) -> None:
    with pytest.raises(UnknownNameError, match="Unknown entity"):
        entity_named(name)


@pytest.mark.parametrize(("color", "kind"), [("", CUBE), ("red", STICK_KIND)])
def test_an_entity_has_the_color_that_its_kind_wants(
    color: str, kind: ObjectKind
) -> None:
    with pytest.raises(UnknownNameError, match="color"):
        Entity(color, kind)


def test_what_is_added_is_numbered_behind_the_benchmark() -> None:
    OBJECT_KINDS.add("can", cylinder("can", 0.03, 0.08, 0.1))
    OBJECT_COLORS.add("purple", (0.5, 0.2, 0.6, 1.0))
    added = extra_entities()
    assert known_entities() == (*ENTITIES, *added)
    assert added[:2] == ("purple_cube", "purple_pad")
    assert added[2:] == tuple(f"{color}_can" for color in OBJECT_COLORS)
    assert entity_named("purple_can").phrase == "purple can"


def test_a_kind_of_one_color_is_called_by_its_kind() -> None:
    mug = OBJECT_KINDS.add(
        "mug", cylinder("mug", 0.03, 0.09, 0.2, color=(0.3, 0.2, 0.1, 1.0))
    )
    assert entity_named("mug") == Entity("", mug)
    assert ObjectPlacement("mug", "brown", Pose2(0.0, 0.0)).name == "mug"
    assert extra_entities() == ("mug",)


def test_spacings_not_given_leave_room_for_fingers() -> None:
    can = cylinder("can", 0.03, 0.08, 0.1)
    assert CUBE.spacing_to(CUBE) == 0.125
    assert PAD.spacing_to(CUBE) == CUBE.spacing_to(PAD) == 0.15
    assert can.spacing_to(CUBE) == CUBE.spacing_to(can)
    assert can.spacing_to(CUBE) == pytest.approx(0.03 + 0.036 + 0.055)


def test_a_box_is_held_across_its_narrower_side() -> None:
    brick = box("brick", (0.04, 0.12, 0.05), 0.2)
    assert brick.grasp is not None
    assert (brick.grasp.width_m, brick.grasp.turn_rad) == (0.04, math.pi)
    # The fingers close along the gripper's y axis.
    assert brick.grasp.at.yaw == pytest.approx(math.pi / 2)


def test_a_tall_thing_is_grasped_so_high_that_it_clears_the_palm() -> None:
    tower = cylinder("tower", 0.02, 0.2, 0.2)
    assert tower.grasp is not None
    assert 0.0 < PALM_ABOVE_TCP_M - (tower.height_m - tower.grasp.height_m) < 0.01


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"name": "tin_can"}, "lower-case letters"),
        ({"name": "shared"}, "none of shared"),
        ({"nouns": ("Can",)}, "no noun"),
        ({"radius_m": 0.051}, "the fingers open to 0.1 m"),
        ({"height_m": -0.1}, "positive"),
        ({"mass_kg": 0.0}, "mass of each of its parts"),
        ({"fixed": True}, "fixed to the table has no grasp"),
        ({"grasp": Grasp(0.06, 0.02, 0.0)}, "touch the palm"),
        ({"grasp": Grasp(0.06, 0.05, 0.0, Pose2(0.02, 0.0))}, "beside its middle"),
    ],
)
def test_a_kind_that_cannot_be_is_refused(changes: dict, reason: str) -> None:
    values = {"name": "can", "radius_m": 0.03, "height_m": 0.08, "mass_kg": 0.1}
    with pytest.raises(InvalidConfigError, match=reason):
        cylinder(**{**values, **changes})
    assert FINGER_OPENING_M == 0.1


@pytest.mark.parametrize(
    ("shape", "sizes"),
    [
        ("cone", (0.1,)),
        ("box", (0.1, 0.1)),
        ("sphere", (0.0,)),
        ("sphere", (-1.0,)),
    ],
)
def test_a_part_has_the_sizes_of_its_shape(
    shape: str, sizes: tuple[float, ...]
) -> None:
    with pytest.raises(InvalidConfigError, match="shapes"):
        Part(shape, sizes)


@pytest.mark.parametrize(
    ("name", "rgba"),
    [
        ("dark_red", (0.5, 0.1, 0.1, 1.0)),
        ("Purple", (0.5, 0.1, 0.1, 1.0)),
        ("purple", (0.5, 0.1, 0.1)),
        ("purple", (128.0, 0.1, 0.1, 1.0)),
        ("purple", (0.5, 0.1, 0.1, 0.5)),
        ("purple", (math.nan, 0.1, 0.1, 1.0)),
    ],
)
def test_a_color_that_cannot_be_is_refused(
    name: str, rgba: tuple[float, float, float, float]
) -> None:
    with pytest.raises(InvalidConfigError, match=name):
        OBJECT_COLORS.add(name, rgba)
    assert name not in OBJECT_COLORS


def test_a_builder_adds_what_parts_cannot_say() -> None:
    def build(spec, body, name: str) -> None:
        body.add_site(name=f"{name}/lid", pos=[0.0, 0.0, 0.04])

    OBJECT_KINDS.add("can", cylinder("can", 0.03, 0.08, 0.1, build=build))
    placed = ObjectPlacement("can", "red", Pose2(0.3, 0.1))
    scene = Scene(SceneSpec((), (placed,)))
    scene.refresh()
    assert scene.data.site("red_can/lid").xpos == pytest.approx([0.3, 0.1, 0.08])
    assert scene.model.body("red_can").mass[0] == pytest.approx(0.1)


def test_a_fixed_kind_stands_on_the_table_at_its_height() -> None:
    OBJECT_KINDS.add(
        "stand",
        ObjectKind(
            name="stand",
            parts=(Part("box", (0.05, 0.05, 0.03)),),
            fixed=True,
            height_m=0.06,
            origin_m=0.03,
            disc_m=0.071,
            side_m=0.05,
            support_m=0.04,
            obstacle=(),
            shell=Shell((), 0.0),
        ),
    )
    scene = Scene(SceneSpec((), (ObjectPlacement("stand", "red", Pose2(0.2, 0.0)),)))
    assert scene.movable_names == ()
    assert scene.pose("red_stand").position == (0.2, 0.0, 0.03)
    scene.refresh()
    assert scene.data.geom("red_stand").xpos[2] == pytest.approx(0.03)


def test_the_stick_is_a_tool() -> None:
    assert kind_of(STICK).tool
    assert not kind_of(STICK).cargo
