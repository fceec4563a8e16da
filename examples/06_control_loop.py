"""The control level: images and joints in, motor commands out, 20 times a second.

python examples/06_control_loop.py [INDEX]

A script picks up a cube with the nearer arm. A policy would use the images; the script
uses the true state in ``info``.
"""

import math
import sys

import numpy as np

import lemma

index = int(sys.argv[1]) if len(sys.argv) > 1 else 1
env = lemma.make(
    *("pass",),
    control="ee_pose",
    observation="rgb",
    width=64,
    height=48,
    split="val",
    index=index,
)
observation, info = env.reset()
print(info["instruction"])
for name, picture in observation["pixels"].items():
    print(f"{name}: picture {picture.shape}")
print("an action:", *env.action_layout.columns)

cube = env.instance.goal.pairs[0][0]
x, y, z, qw, _, _, qz = info["state"][cube]
hands = observation["tcp_pose"].reshape(2, 7)
robot = int(np.argmin(np.hypot(hands[:, 0] - x, hands[:, 1] - y)))
turn = math.atan2(qz, qw)  # half the yaw of the cube
down = (0.0, math.cos(turn), math.sin(turn), 0.0)

# Target position [m] and opening [m] of the hand, and duration [s].
WAY = [
    ((x, y, z + 0.15), 0.1, 3.0),
    ((x, y, z), 0.1, 2.0),
    ((x, y, z), 0.0, 1.0),
    ((x, y, z + 0.15), 0.0, 2.0),
]
# The command of the other arm is its present pose.
action = np.hstack([hands, np.full((2, 1), 0.1)])
for position, opening, seconds in WAY:
    action[robot] = *position, *down, opening
    for _ in range(round(seconds * 20)):
        observation, reward, terminated, truncated, info = env.step(action)
        if terminated or truncated:
            sys.exit(f"The episode has failed: {info['failure']}")
    hand = observation["tcp_pose"].reshape(2, 7)[robot, :3]
    print(f"{info['elapsed_s']:5.2f} s  hand at {hand.round(3)}")

lifted = info["state"][cube][2] - z
print(f"robot_{robot} lifted the {cube} by {100 * lifted:.0f} cm")
env.close()
sys.exit(int(lifted < 0.1))
