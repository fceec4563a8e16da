"""Arms and gripper: numbers, bodies, kinematics and reach."""
