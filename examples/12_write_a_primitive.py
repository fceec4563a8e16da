"""A new primitive: push a cube into the shared region with closed fingers.

python examples/12_write_a_primitive.py [INDEX]
"""

import math
import sys
from collections.abc import Iterator

import lemma
from lemma.core.poses import Pose2
from lemma.motion.arm_motion import ArmMotion
from lemma.motion.moves import Motion, Moves
from lemma.motion.skills import SkillRunner, stand_at
from lemma.planning.geometry import GroundedOption, SceneGeometry
from lemma.planning.primitives import Wish
from lemma.planning.symbolic_state import TABLE, SymbolicState
from lemma.robots.reach import TRAVEL_HEIGHT_M
from lemma.scene.objects.entity import SHARED, STICK
from lemma.tasks.drags import stick_discs
from lemma.tasks.subtask import GroundedSubTask, Primitive, SubTask

HEIGHT_M = 0.025
BEHIND_M = 0.06
"""Distance of the cube's center from the point where the fingers come down."""
TOUCHING_M = 0.036
"""Distance of the cube's center from the fingers that push it."""
SPEED_M_S = 0.1
LONGEST_M = 0.60
CORRIDOR_M = 0.06


def push(runner: SkillRunner, arm: ArmMotion, subtask: GroundedSubTask) -> Motion:
    """Move down at the pick pose, and straight to the place pose."""
    moves = Moves(arm)
    start, end = (stand_at(p, HEIGHT_M) for p in (subtask.pick, subtask.place))
    over = stand_at(subtask.pick, TRAVEL_HEIGHT_M)
    moves.check_reach(start, "pick")
    moves.check_reach(end, "place")
    runner.feel(arm, subtask.pick, None)
    arm.opening_m = 0.0
    yield from moves.to(over, fly_by=True)
    yield from moves.wait_for_fingers()
    yield from moves.lower(start)
    yield from moves.along(start, end, SPEED_M_S)
    yield from moves.rise(end, TRAVEL_HEIGHT_M)


def ground(
    geometry: SceneGeometry, subtask: SubTask, now: SymbolicState
) -> GroundedOption | None:
    """Return a straight push to the best free place, if no object is in the way."""
    robot, cube = subtask.robot, subtask.pick
    if subtask.place != SHARED or now.supports.get(cube) != TABLE:
        return None
    obstacles = geometry.discs(now, but=cube)
    if STICK in now.poses:
        obstacles += stick_discs(now.poses[STICK])
    start, target = now.poses[cube], geometry.regions[SHARED].free_spot(obstacles)
    if target is None or not 0.05 < start.distance(target) < LONGEST_M:
        return None
    way = Pose2(start.x, start.y, math.atan2(target.y - start.y, target.x - start.x))
    length = start.distance(target)
    steps = [i * length / 20 for i in range(-5, 21)]
    for x, y, radius in obstacles:
        if any(
            (way @ Pose2(s, 0)).distance(Pose2(x, y)) < radius + CORRIDOR_M
            for s in steps
        ):
            return None
    pick, place = way @ Pose2(-BEHIND_M, 0), way @ Pose2(length - TOUCHING_M, 0)
    if geometry.margin(robot, pick, place) <= 0.0:
        return None
    return GroundedOption(
        subtask,
        GroundedSubTask(robot, subtask.primitive, pick, place),
        now.moved(cube, Pose2(target.x, target.y, start.yaw), TABLE, SHARED),
        geometry.quality(robot, pick, place),
        # Shorter than a move, without grasp and release.
        geometry.duration_s(robot, pick, place) - 3.0,
    )


def propose(robot: str, wish: Wish, now: SymbolicState) -> Iterator[SubTask]:
    """Propose to push a wanted object in reach to the shared region."""
    if SHARED in wish.places and wish.item in now.supports and robot in wish.able:
        yield SubTask(robot, Primitive("push"), wish.item, SHARED)


def why_not(subtask: SubTask, now: SymbolicState) -> str | None:
    """Return why a push is impossible, in one sentence; None if it may be possible."""
    if subtask.pick not in now.supports or subtask.place != SHARED:
        return f"A cube is pushed to the shared space, not {subtask.pick} to another."
    above = now.on_top_of(subtask.pick)
    return None if above is None else f"The {above} lies on the {subtask.pick}."


lemma.PRIMITIVES.add(
    "push",
    lemma.PrimitiveSpec(
        name="push",
        phrase="{robot}: push the {pick} to the {place}",
        skill=push,
        ground=ground,
        candidates=propose,
        why_not=why_not,
    ),
)

if __name__ == "__main__":
    index = int(sys.argv[1]) if len(sys.argv) > 1 else 39
    env = lemma.make("pass", level="plan", split="test", index=index)
    expert = lemma.ExpertPolicy(env)
    observation, info = env.reset()
    print(info["instruction"])
    done = False
    while not done:
        action = expert.act(observation)
        observation, reward, terminated, truncated, info = env.step(action)
        print(f"{env.decode(action)}: {info['outcome']} {info['explanation']}")
        done = terminated or truncated
    print(f"{'success' if reward else 'failure'} after {info['elapsed_s']:.1f} s")
    sys.exit(reward != 1.0)
