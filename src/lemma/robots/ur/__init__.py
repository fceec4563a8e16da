"""The UR arms: dimensions, kinematics, meshes."""
