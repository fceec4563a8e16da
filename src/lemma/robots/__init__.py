"""Arms and gripper: dimensions, MuJoCo bodies, kinematics and reachable sets."""
