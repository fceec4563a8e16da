"""An object, a color and a task of a user's own work wherever the benchmark's do."""

from collections.abc import Iterator

import numpy as np
import pytest
from faulty_policies import given
from gymnasium.spaces import Discrete
from own_plugins import EXAMPLES, loaded

import lemma
from lemma.core.errors import InvalidActionError, InvalidConfigError
from lemma.dataset.recipe.record import record_episode
from lemma.dataset.recipe.replay import replay
from lemma.dataset.rendered.capture import entities_of, entity_poses
from lemma.env.action_spaces import PICKS, PLACES, decode_plan, encode_plan, plan_space
from lemma.env.control.safety_filter import SafetyFilter
from lemma.env.observation import object_poses
from lemma.evaluation.protocol.language_controls import control_of
from lemma.evaluation.run.fault_isolation import check
from lemma.motion.obstacles import Obstacles
from lemma.planning.symbolic_state import SymbolicState
from lemma.policies.batch import decision_numbers
from lemma.policies.interfaces import Decision
from lemma.scene.objects.entity import ENTITIES, kind_of, known_entities
from lemma.scene.raster import RASTER
from lemma.tasks.instance import Instance
from lemma.tasks.subtask import Primitive, SubTask
from lemma.viz.sheets import instance_sheet

CAN = "purple_can"


@pytest.fixture(autouse=True)
def _registered() -> Iterator[None]:
    with loaded(EXAMPLES / "11_write_an_object.py"):
        yield


def instance(seed: int = 0) -> Instance:
    return lemma.load_instance("can_stack", "free", seed)


def test_an_instance_is_plain_data() -> None:
    assert Instance.from_dict(instance().to_dict()) == instance()
    assert ["can", "purple"] in [row[:2] for row in instance().to_dict()["objects"]]


def test_instructions_speak_of_it_and_are_understood() -> None:
    goal = instance().goal
    language = lemma.TASKS["can_stack"].language
    for sentence in instance().instructions.values():
        assert "purple can" in sentence
        assert language.parse(sentence) == frozenset(goal.pairs)


def test_the_expert_solves_it_and_the_record_is_exact() -> None:
    record = record_episode(instance())
    assert record.success
    assert len(record.subtasks) == 3
    assert any("purple can" in row.instruction for row in record.subtasks)
    assert replay(record).is_exact
    scene = lemma.Episode(instance()).simulation.scene
    scene.restore(record.state(3))
    supports = SymbolicState.observe(scene).supports
    assert set(instance().goal.pairs) <= set(supports.items())


def test_benchmark_numbers_stay_and_others_come_behind() -> None:
    space = plan_space(2)
    pick = space["pick"]
    assert isinstance(pick, Discrete)
    assert pick.n == len(PICKS) + len(known_entities()) - len(ENTITIES)
    red_cube = SubTask("robot_0", Primitive.MOVE, "red_cube", "shared")
    action = encode_plan(red_cube)
    assert (action["pick"], action["place"]) == (2, len(PLACES) - 1)
    moved = SubTask("robot_1", Primitive.MOVE, CAN, "shared")
    assert encode_plan(moved)["pick"] >= len(PICKS)
    assert space.contains(encode_plan(moved))
    assert decode_plan(encode_plan(moved), 2) == moved
    with pytest.raises(InvalidActionError, match="green_ball"):
        encode_plan(SubTask("robot_0", Primitive.MOVE, "green_ball", "shared"))


def test_observations_of_the_truth_have_rows_for_it() -> None:
    env = lemma.make("can_stack", split="free", index=0, observation="privileged")
    observation, info = env.reset()
    assert env.observation_space.contains(observation)
    row = known_entities().index(CAN)
    assert observation["present"][row] == 1
    pose = info["state"][CAN]
    assert observation["objects"][row] == pytest.approx(pose, abs=1e-6)
    assert observation["goal"][row].sum() == 1


def test_rendered_labels_have_rows_for_it() -> None:
    scene = lemma.Episode(instance()).simulation.scene
    poses = entity_poses(object_poses(scene), entities_of(instance().task))
    assert poses.shape == (len(known_entities()), 7)
    assert np.isfinite(poses[known_entities().index(CAN)]).all()


def test_arms_keep_clear_of_its_whole_height() -> None:
    simulation = lemma.Episode(instance()).simulation
    arms = simulation.arms
    rows = Obstacles(arms).around("robot_0", None, None)
    x, y, z = simulation.scene.pose(CAN).position
    own = [row for row in rows if np.hypot(row[0] - x, row[1] - y) < 1e-9]
    assert len(own) == 1
    low, high = sorted((own[0][2] - own[0][6], own[0][5] + own[0][6]))
    assert (low, high) == pytest.approx((z - 0.04, z + 0.04))


def test_the_safety_filter_knows_what_the_hand_holds() -> None:
    simulation = lemma.Episode(instance()).simulation
    arms = simulation.arms
    arm = arms["robot_0"]
    watch = SafetyFilter(tuple(arms.values()))
    watch.look()
    assert watch.records["inside"].tolist() == [0, 0]
    scene = simulation.scene
    pose = scene.pose(CAN)
    held = type(pose)(tuple(arm.tcp_pose()[:3, 3]), pose.quaternion)
    scene.set_pose(CAN, held)
    scene.set_joints(arm.robot, scene.data.qpos[arm.robot.qpos].copy(), 0.06)
    watch.look()
    assert watch.records["inside"].tolist() == [1, 0]


def test_learned_policies_say_that_they_have_no_number_for_it() -> None:
    with pytest.raises(InvalidConfigError, match="no number for 'purple_can'"):
        decision_numbers(SubTask("robot_0", Primitive.MOVE, CAN, "shared").to_dict())
    with pytest.raises(InvalidConfigError, match="and no 'lift'"):
        decision_numbers(SubTask("robot_0", Primitive.LIFT, CAN, CAN).to_dict())


def test_a_decision_may_name_it() -> None:
    decision = Decision(SubTask("robot_0", Primitive.MOVE, CAN, "shared"), None)
    assert check(decision, given()) == decision


def test_another_goal_is_asked_for_in_the_same_words() -> None:
    said = control_of("swapped", instance(), "high_level")
    assert said.sentence is not None
    asked = lemma.TASKS["can_stack"].language.parse(said.sentence)
    assert asked is not None
    assert asked != frozenset(instance().goal.pairs)
    assert {kind_of(name).name for pair in asked for name in pair} == {
        *("can", "cube", "pad")
    }


@pytest.mark.slow
@pytest.mark.render
def test_it_is_drawn_in_its_color() -> None:
    env = lemma.make("can_stack", split="free", index=0, observation="map")
    observation, info = env.reset()
    position = info["state"][CAN]
    row = round(RASTER.rows / 2 - position[1] / RASTER.cell_m)
    column = round(RASTER.columns / 2 + position[0] / RASTER.cell_m)
    red, green, blue = (int(part) for part in observation["map"]["rgb"][row, column])
    assert blue > red > 1.3 * green
    assert observation["map"]["height_m"][row, column] == pytest.approx(0.08, abs=0.005)
    sheet = np.asarray(instance_sheet(instance()))
    assert sheet.ndim == 3
