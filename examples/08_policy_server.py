"""A policy server, and the benchmark as its client.

python examples/08_policy_server.py         both in one process, for one episode
python examples/08_policy_server.py 8000    serve until Ctrl-C; then, elsewhere:
lemma evaluate --policy http://127.0.0.1:8000 --tasks stack --out out/by_color

A server needs NumPy, Gymnasium, msgspec and websockets, and neither MuJoCo nor
torch. It may run in another environment, in a container, or on another machine.
"""

import sys
from collections.abc import Sequence

import numpy as np

from lemma.core.poses import Pose2
from lemma.env.view import View
from lemma.policies.interfaces import Decision, PolicyInput
from lemma.scene.objects.palette import OBJECT_COLORS
from lemma.serve import PolicyServer, serve
from lemma.tasks.language.bank import parse
from lemma.tasks.subtask import STOP, GroundedSubTask, Primitive, SubTask

CELL_M = 0.008
CUBE_M = 0.05


class ByColor:
    """Finds the cubes of the instruction by color, and stacks them in the middle.

    It makes two moves, without learning: a template for your own model.
    """

    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        """Return the next decision of each episode."""
        return [self.decide(policy_input) for policy_input in inputs]

    def decide(self, policy_input: PolicyInput) -> Decision:
        """Return the next decision of one episode, from its past and its view."""
        goal = parse(policy_input.instruction)
        if goal is None or len(policy_input.past) == 2:
            return Decision(STOP, None)
        [(top, bottom)] = sorted(goal)[:1]
        entity = top if policy_input.past else bottom
        pick = find(policy_input.view, entity.partition("_")[0])
        if pick is None:
            return Decision(STOP, None)
        # The first robot is at -x.
        robot = "robot_0" if pick.x < 0 else "robot_1"
        subtask = SubTask(robot, Primitive.MOVE, entity, "shared")
        place = Pose2(0.0, 0.0, 0.0)
        return Decision(
            subtask, GroundedSubTask(robot, Primitive.MOVE, pick, place), "by color"
        )


def find(view: View, color: str) -> Pose2 | None:
    """Return the center of the cube of a color on the map."""
    rgb = view.rgb / (view.rgb.sum(-1, keepdims=True) + 1.0)
    names = list(OBJECT_COLORS)
    shades = np.array([OBJECT_COLORS[name][:3] for name in names])
    shades = shades / shades.sum(-1, keepdims=True)
    nearest = np.linalg.norm(rgb[..., None, :] - shades, axis=-1).argmin(-1)
    tall = np.abs(view.height_m - CUBE_M) < 0.01
    rows, columns = np.nonzero(tall & (nearest == names.index(color)))
    if len(rows) == 0:
        return None
    height, width = view.height_m.shape
    # Row 0 is at +y, column 0 at -x.
    return Pose2(
        float(np.median(columns) + 0.5 - width / 2) * CELL_M,
        float(height / 2 - np.median(rows) - 0.5) * CELL_M,
    )


def ask(url: str) -> None:
    """Play one episode with the policy server at an address."""
    # Imported here, because only the benchmark's side needs the simulator.
    from lemma.evaluation.run.rollout import Player, Rollout, roll_out  # noqa: PLC0415
    from lemma.policies.spec import PolicySpec  # noqa: PLC0415
    from lemma.tasks.suite import load_instance  # noqa: PLC0415

    [play] = roll_out(
        [Rollout(load_instance("stack", "test", 0))], Player.load(PolicySpec(url))
    )
    print(play.instruction)
    for step in play.steps:
        print(f"  {step.subtask}: {step.result.outcome}")
    print("success" if play.success else f"failure: {play.failure}")


if __name__ == "__main__":
    if len(sys.argv) > 1:
        serve(ByColor(), port=int(sys.argv[1]), on_ready=print)
    else:
        with PolicyServer(ByColor(), port=0) as server:
            ask(server.url)
