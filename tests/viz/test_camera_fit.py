import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from lemma.env.simulation import Simulation
from lemma.tasks.suite import load_instance
from lemma.viz.annotate import false_color, fitting_size, label_plate, text_width
from lemma.viz.camera_fit import NEAREST_M, outline, overview

coordinates = st.floats(-2.0, 2.0)
points = st.lists(st.tuples(coordinates, coordinates, st.floats(0.0, 1.0)))
BOX = [(x, y, z) for x in (-0.4, 0.4) for y in (-0.4, 0.4) for z in (0.0, 0.3)]
"""Without some extent the camera would stand where the points are."""


@given(
    points=points,
    azimuth_deg=st.floats(0.0, 360.0),
    elevation_deg=st.floats(-80.0, -5.0),
    aspect=st.floats(0.5, 3.0),
)
@example(points=[(-2.0, 0.0, 0.5)], azimuth_deg=0.0, elevation_deg=-5.0, aspect=2.0)
def test_everything_is_in_the_picture_and_no_farther_than_needed(
    points: list[tuple[float, float, float]],
    azimuth_deg: float,
    elevation_deg: float,
    aspect: float,
) -> None:
    margin = 0.05
    points = [*BOX, *points]
    camera = overview(
        points,
        aspect,
        azimuth_deg=azimuth_deg,
        elevation_deg=elevation_deg,
        margin=margin,
    )
    height = 1000
    width = round(height * aspect)
    pixels, depth_m = camera.camera(width, height).project(points)
    assert depth_m.min() > NEAREST_M - 1e-9
    relative = (pixels + 0.5) / (width, height)
    inside = 0.003 + margin
    assert relative.min() > margin - 0.003
    assert relative.max() < 1 - margin + 0.003
    # On two opposite sides something touches the margin, or a point would be too near.
    touches = (relative.min(axis=0) < inside) & (relative.max(axis=0) > 1 - inside)
    assert touches.any() or depth_m.min() < NEAREST_M + 1e-9


def test_outline_is_around_the_arms_and_the_objects() -> None:
    scene = Simulation(load_instance("hook", "test", 0).scene).scene
    scene.refresh()
    corners = outline(scene)
    low, high = corners.min(axis=0), corners.max(axis=0)
    for name in scene.spec.object_names:
        x, y, z = scene.pose(name).position
        assert np.all(low <= (x, y, z))
        assert np.all(high >= (x, y, z))
    for robot in scene.spec.robots:
        assert low[0] < robot.base.x < high[0]
    assert high[2] > 0.5
    assert low[2] > -0.2


def test_text_is_made_to_fit() -> None:
    text = "Place the red cube on top of the white cube"
    size = fitting_size(text, 40.0, 300.0)
    assert text_width(text, size) == pytest.approx(300.0, rel=0.05)
    assert fitting_size("a", 40.0, 300.0) == 40.0


def test_labels_do_not_cover_each_other() -> None:
    first = label_plate((100, 100), "red_cube", 10.0, 20.0, [], (500, 500))
    second = label_plate((100, 100), "blue_cube", 10.0, 20.0, [first], (500, 500))
    assert first[1][1] < 100 < second[0][1]


def test_false_color_grows_darker_with_distance() -> None:
    values = np.linspace(0.9, 2.1, 50, dtype=np.float32)[None]
    brightness = false_color(values, 1.0, 2.0).astype(int).sum(axis=-1)[0]
    assert np.all(np.diff(brightness) <= 12)
    assert brightness[0] > 2 * brightness[-1]
