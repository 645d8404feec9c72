"""The report on a grasp."""
