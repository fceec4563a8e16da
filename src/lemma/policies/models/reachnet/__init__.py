"""ReachNet: perception, goal reader, planner and grounder."""
