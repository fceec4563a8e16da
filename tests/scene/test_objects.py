"""Cubes, pads and the stick: their sizes, masses and frames as MuJoCo has them."""

import itertools
import math

import mujoco
import numpy as np
import pytest

from lemma.core.poses import FloatArray, Pose2
from lemma.scene.objects.bodies import add_object, resting_quaternion
from lemma.scene.objects.cube import CUBE_EDGE_M, CUBE_MASS_KG
from lemma.scene.objects.kind import OBJECT_KINDS, ObjectKind, Part
from lemma.scene.objects.pad import PAD_RADIUS_M, PAD_THICKNESS_M
from lemma.scene.objects.palette import OBJECT_COLORS, STICK
from lemma.scene.objects.stick import HANDLE_LENGTH_M, HOOK_LENGTH_M, STICK_SECTION_M
from lemma.scene.spec import ObjectPlacement

POSE = Pose2(0.3, -0.2, 0.7)


def compiled(kind: str, color: str = "pink") -> tuple[mujoco.MjModel, mujoco.MjData]:
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    add_object(spec, ObjectPlacement(kind, color, POSE).entity, POSE)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def test_sizes_are_those_of_the_design() -> None:
    assert CUBE_EDGE_M == 0.05
    assert PAD_RADIUS_M == 0.06
    assert (HANDLE_LENGTH_M, HOOK_LENGTH_M, STICK_SECTION_M) == (0.75, 0.15, 0.03)
    heights = {kind: OBJECT_KINDS[kind].height_m for kind in OBJECT_KINDS}
    assert heights == {
        **{"cube": 0.05, "pad": 0.035, "plank": 0.03, "stick": 0.03},
        **{"rod": 0.03, "tray": 0.03, "rack": 0.06},
    }


@pytest.mark.parametrize("color", OBJECT_COLORS)
def test_a_cube(color: str) -> None:
    model, data = compiled("cube", color)
    name = f"{color}_cube"
    assert model.geom(name).size.tolist() == [0.025] * 3
    assert model.geom(name).rgba == pytest.approx(OBJECT_COLORS[color])
    assert model.body(name).mass[0] == pytest.approx(CUBE_MASS_KG)
    assert model.joint(name).type[0] == mujoco.mjtJoint.mjJNT_FREE
    assert data.body(name).xpos.tolist() == [0.3, -0.2, 0.025]
    # A solid block: m a^2 / 6 about every axis.
    inertia = CUBE_MASS_KG * CUBE_EDGE_M**2 / 6
    assert model.body(name).inertia == pytest.approx([inertia] * 3)


def test_a_pad_is_fixed_to_the_table() -> None:
    model, data = compiled("pad")
    assert model.nv == 0
    assert model.geom("pink_pad").type[0] == mujoco.mjtGeom.mjGEOM_CYLINDER
    assert model.geom("pink_pad").size[:2].tolist() == [PAD_RADIUS_M, 0.0175]
    assert data.body("pink_pad").xpos.tolist() == [0.3, -0.2, 0.0]
    # Its underside lies on the table.
    assert data.geom("pink_pad").xpos[2] == pytest.approx(PAD_THICKNESS_M / 2)


def test_the_stick_starts_at_the_free_end_of_its_handle() -> None:
    model, data = compiled("stick", "yellow")
    half = STICK_SECTION_M / 2
    assert data.body("stick").xpos.tolist() == [0.3, -0.2, half]
    for geom, low, high in (
        ("stick/handle", (0.0, -half), (0.75, half)),
        ("stick/hook", (0.72, half), (0.75, 0.135)),
    ):
        centre = POSE @ Pose2(0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]))
        assert data.geom(geom).xpos == pytest.approx([centre.x, centre.y, half])
        size = model.geom(geom).size
        assert 2 * size[0] == pytest.approx(high[0] - low[0])
        assert 2 * size[1] == pytest.approx(high[1] - low[1])
        assert 2 * size[2] == pytest.approx(STICK_SECTION_M)
        assert model.geom(geom).rgba == pytest.approx(STICK)
    # From the handle's far side to the tip of the hook it measures 150 mm.
    assert 0.135 + half == pytest.approx(HOOK_LENGTH_M)
    # Light enough for the smaller arm to hold at its end.
    assert 0.05 < model.body("stick").mass[0] < 0.2


@pytest.mark.parametrize("yaw", [-3.0, 0.0, 0.4, 2.0])
def test_a_resting_quaternion_turns_about_the_vertical(yaw: float) -> None:
    w, x, y, z = resting_quaternion(yaw)
    assert (x, y) == (0.0, 0.0)
    assert math.atan2(2 * w * z, 1 - 2 * z * z) == pytest.approx(yaw)


def surface(part: Part) -> FloatArray:
    """Return points of a box or of the rims of an upright cylinder, (n, 3) [m]."""
    if part.shape == "box":
        around = np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=3)))
        points = around * part.size_m
    else:
        radius, half = part.size_m
        turns = np.linspace(0.0, 2.0 * np.pi, 33)
        points = np.array(
            [
                (radius * np.cos(turn), radius * np.sin(turn), z)
                for turn in turns
                for z in (-half, half)
            ]
        )
    return points + np.array(part.position_m)


def outside_m(kind: ObjectKind) -> float:
    """Return how far an object sticks out of its safety shell at most [m].

    Corners and edges are enough where one capsule is nearest to all of a part.
    """
    farthest = -math.inf
    for point in np.concatenate([surface(part) for part in kind.parts]):
        gaps: list[float] = []
        for capsule in kind.shell.capsules:
            start, end = np.array(capsule.start), np.array(capsule.end)
            along = end - start
            share = np.dot(point - start, along) / max(np.dot(along, along), 1e-12)
            nearest = start + np.clip(share, 0.0, 1.0) * along
            gaps.append(float(np.linalg.norm(point - nearest)) - capsule.radius_m)
        farthest = max(farthest, min(gaps))
    return farthest


@pytest.mark.parametrize("name", ["cube", "pad"])
def test_the_guard_knows_all_of_a_cube_and_a_pad(name: str) -> None:
    assert outside_m(OBJECT_KINDS[name]) <= 1e-9


def test_the_guard_knows_the_stick_but_for_the_inner_edges_of_its_hook() -> None:
    """The hook's capsule runs along its outer face, so its inner edges stick out."""
    assert outside_m(OBJECT_KINDS["stick"]) <= 0.0096
