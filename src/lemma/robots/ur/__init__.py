"""The UR arms: numbers, kinematics, meshes."""
