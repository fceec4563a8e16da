"""Objects that arms hide from the cameras of the map."""

import pytest

from lemma.core.poses import Pose
from lemma.env.episode import Episode
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.tasks.suite import load_instance
from measure_hidden import Eye, is_below

pytestmark = pytest.mark.render


@pytest.mark.parametrize(
    ("task", "index", "hidden"),
    [
        ("pass", 0, {}),
        ("pass", 11, {"red_cube": True}),
        ("stack", 47, {"green_cube": False}),
    ],
)
def test_arms_hide_parts_of_goals(
    task: str, index: int, hidden: dict[str, bool]
) -> None:
    assert dict(Eye().hidden(Episode(load_instance(task, "test", index)))) == hidden


def test_what_carries_something_is_not_counted() -> None:
    episode = Episode(load_instance("stack", "test", 0))
    scene = episode.simulation.scene
    ((top, bottom),) = episode.instance.goal.pairs
    assert not is_below(scene, bottom)
    x, y, z = scene.position(bottom)
    scene.set_pose(top, Pose((x, y, z + CUBE_EDGE_M), (1.0, 0.0, 0.0, 0.0)))
    scene.refresh()
    assert is_below(scene, bottom)
    assert not is_below(scene, top)
    assert not dict(Eye().hidden(episode))
