"""The synthetic sample split and the synthetic planners that give a fresh board its first rows.

Everything follows from one seed. `road` is the lane, `hazards` says where each task's region lies,
`scenes` draws scenes and samples, `planners` drives through them, `files` writes all of it.
Nothing here comes from a recorded drive.
"""
