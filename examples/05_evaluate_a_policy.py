"""Evaluate your own policy: a planner that tries one robot after the other.

python examples/05_evaluate_a_policy.py [EPISODES]
lemma evaluate --policy my_module:TriesEachRobot --level plan --tasks pass --out DIR
"""

import sys
from collections.abc import Sequence

import lemma
from lemma.policies.interfaces import PolicyInput
from lemma.tasks.language.bank import parse
from lemma.tasks.subtask import STOP, Primitive, SubTask


class TriesEachRobot:
    """Moves a cube to the shared region and from there to its pad.

    A planner returns symbolic sub-tasks, and an oracle adds the poses. The planner is
    stateless: its inputs have all views and decisions, for many episodes at a time.
    """

    def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
        """Return the next sub-task of each episode."""
        return [self.next(policy_input) for policy_input in inputs]

    def next(self, policy_input: PolicyInput) -> SubTask:
        """Return the next sub-task of one episode."""
        goal = parse(policy_input.instruction)
        done = [step for step in policy_input.past if step.outcome == "success"]
        if goal is None or len(done) == 2:
            return STOP
        [(cube, pad)] = goal
        # The robots alternate, whether or not the last sub-task succeeded.
        robot = "robot_0"
        if policy_input.past and policy_input.past[-1].subtask.robot == "robot_0":
            robot = "robot_1"
        return SubTask(robot, Primitive.MOVE, cube, pad if done else "shared")


if __name__ == "__main__":
    episodes = int(sys.argv[1]) if len(sys.argv) > 1 else 10
    found = lemma.evaluate(
        TriesEachRobot(), tasks=["pass"], split="val", episodes=episodes
    )
    # By the strict verdict, a sub-task that its robot cannot do ends the episode. By
    # the lenient one, the policy gets the outcome and continues.
    print(found)
    for row in found.rows:
        print(f"val {row['index']}: {row['failure'] or 'success'}")
