"""`scripts/measure_page.py`: the page shows the same episode; speed is not tested."""

from lemma.tasks.suite import load_instance
from measure_page import measure_page


def test_a_visitor_sees_an_episode_that_is_the_same_without_one() -> None:
    found = measure_page(load_instance("pass", "val", 0), speed=8.0)
    assert found.same_state
    assert found.updates_hz > 0.0
    assert 0.0 < found.realtime <= 8.1
    assert found.kb_s > 0.0
    assert 0.0 < found.up_s < found.first_scene_s
    assert found.to_dict()["same_state"] is True
