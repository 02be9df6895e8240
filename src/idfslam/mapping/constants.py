"""Numbers on the way from pixels to samples, for the plain and the compiled form. None comes from a paper.

Compiled kernels freeze them, and Numba's cache does not notice when they change: delete it then (`idf-slam doctor` says where).
"""

GRAZING = 0.1  # least |n . d| of a surface's normal and a ray [1]: raised, distances to surfaces at a grazing angle come out too large
FREE_FROM = 0.05  # [m] depth where samples in free space begin; raised, the space close to the camera is left untaught
FREE_TO = 0.1  # [m] least depth where they end, in front of a surface that is too near for any; raised, they reach into such a surface
