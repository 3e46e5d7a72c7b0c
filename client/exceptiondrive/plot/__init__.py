"""Pictures of samples: trajectories, footprints, collision tube, hazard region and clearance.

Needs a split with its hazard regions and numpy (the extra `plot`, which also writes PNG).
"""
