"""Gymnasium's MountainCarContinuous-v0: a domain without a table, a robot or a grasp."""
