"""Four robots act together: each free robot places or hands over a cube.

python examples/15_act_together.py
"""

import lemma
from lemma.tasks.subtask import STOP, Primitive, SubTask

env = lemma.make("carousel", level="plan", acting="together", split="test", index=0)
info = env.reset()[1]
goal, regions = dict(env.instance.goal.pairs), env.instance.scene.regions
pads = env.team.observe().poses


def reaches(region: str, pad: str) -> bool:
    """Return whether a robot at a region reaches a pad."""
    names = (env.robot_names[i] for i in regions[region])
    return any(env.team.grounder.reaches(name, pads[pad]) for name in names)


def best_order(robot: str) -> SubTask | None:
    """Return a useful order, to a pad if possible; each cube is handed over once."""
    useful = [
        order
        for order in env.valid_orders(robot)
        if order.primitive is Primitive.MOVE
        and goal.get(order.pick) not in on_their_way
        if order.place == goal[order.pick]
        or (
            order.place in regions
            and order.pick not in on_their_way
            and reaches(order.place, goal[order.pick])
        )
    ]
    return min(useful, key=lambda order: order.place in regions, default=None)


on_their_way: set[str | None] = {None}
"""Cubes that were handed over, and pads with a cube or an order for one."""
while info["doing"] or not env.episode.is_success:
    orders = []
    for robot in info["free"]:
        order = best_order(robot)
        if order is not None:
            orders.append(order)
            on_their_way.add(order.pick if order.place in regions else order.place)
    truncated, info = env.step(env.encode(*orders))[3:]
    if truncated:
        break
print([str(done.grounded.robot) for done in env.episode.executed])
if not env.episode.is_over:
    env.step(env.encode(STOP))
outcome = "success" if env.episode.is_success else env.episode.failure
print(f"{outcome} after {env.episode.elapsed_s:.1f} s")
