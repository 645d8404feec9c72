"""Workspace, approach, postures, grasp plan."""
