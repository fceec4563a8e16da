"""Meshes of a model: complete, in place, and with faces outwards."""

import numpy as np
import pytest

from lemma.scene.build import compile_model
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.tasks.suite import load_instance
from lemma.viewer.scene.bodies import Shape, shapes_of

MODEL = compile_model(load_instance("poke_stack", "test", 0).scene)
SHAPES = list(shapes_of(MODEL))


def volume_m3(shape: Shape) -> float:
    """Return the enclosed volume; negative where faces look inwards."""
    a, b, c = (shape.vertices[shape.faces[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)


def test_everything_visible_is_drawn_from_outside() -> None:
    seen = {int(MODEL.geom_bodyid[g]) for g in np.flatnonzero(MODEL.geom_group < 3)}
    assert {shape.body for shape in SHAPES} == seen
    for shape in SHAPES:
        assert np.isfinite(shape.vertices).all()
        assert shape.faces.max() == len(shape.vertices) - 1
        assert volume_m3(shape) > 0.0, MODEL.body(shape.body).name


def test_sizes_are_those_of_the_model() -> None:
    cubes = [s for s in SHAPES if MODEL.body(s.body).name.endswith("_cube")]
    assert cubes
    for cube in cubes:
        assert np.ptp(cube.vertices, axis=0) == pytest.approx([CUBE_EDGE_M] * 3)
        assert volume_m3(cube) == pytest.approx(CUBE_EDGE_M**3)
        # Every corner belongs to three faces, which are shaded apart.
        assert len(cube.vertices) == 24


def test_floor_alone_has_no_end() -> None:
    endless = [shape for shape in SHAPES if shape.endless]
    assert len(endless) == 1
    assert MODEL.body(endless[0].body).name == "world"
