"""The environments: motor commands, sub-tasks, and vectors of environments.

python examples/01_gymnasium.py
"""

import gymnasium

import lemma
from lemma.core.poses import Pose2
from lemma.tasks.subtask import GroundedSubTask, Primitive

# Control level: one row of numbers per robot, 20 times a second.
env = gymnasium.make(
    "lemma/Stack-v0", level="control", control="joint_velocity", split="test"
)
observation, info = env.reset(seed=0)
print(info["instruction"])
print(env.get_wrapper_attr("action_layout").columns)
for _ in range(20):
    action = 0.1 * env.action_space.sample()
    observation, reward, terminated, truncated, info = env.step(action)
print(f"after {info['elapsed_s']:.2f} s: joints {observation['agent_pos'].round(2)}")
env.close()

# Skill level: one grounded sub-task per step.
skills = lemma.make("stack", level="skill", split="test", index=0)
observation, info = skills.reset()
cube = skills.instance.goal.pairs[0][0]
x, y = info["state"][cube][:2]
for robot in ("robot_0", "robot_1"):
    move = GroundedSubTask(robot, Primitive.MOVE, Pose2(x, y), Pose2(0.0, 0.0))
    action = skills.encode(move)
    observation, reward, terminated, truncated, info = skills.step(action)
    print(f"{robot}: {info['outcome']}. {info['explanation']}")

# Vectors: with vectorization_mode="async" each environment has its own process.
envs = gymnasium.make_vec(
    "lemma/Poke-v0", num_envs=4, vectorization_mode="sync", split="train"
)
observations, infos = envs.reset(seed=0)
observations, rewards, ends, cuts, infos = envs.step(envs.action_space.sample())
print("four at once:", observations["agent_pos"].shape, rewards)
envs.close()
