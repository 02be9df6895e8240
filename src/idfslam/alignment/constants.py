"""Numbers of the alignment's normal equations, for the plain and the compiled form. None comes from a paper.

Compiled kernels freeze them, and Numba's cache does not notice when they change: delete it then (`idf-slam doctor` says where).
"""

# Distances to the map (`aligner.depth_system`)
KNOWN = 0.9  # of the truncation distance [1]: a point nearer to the surface than this takes part; raised to 1, points in free space do too
LEAST_SLOPE = 0.2  # of the signed distance along its gradient [1]: a point with less takes no part; raised, badly learnt places drop out
SLOPE_FLOOR = 0.7  # [1] distances are divided by the slope, but by no less than this; lowered, flat places count as farther off

# Brightness of landmarks (`photometric.photometric_term`)
NEAREST = 0.05  # [m] least depth of a landmark in the frame; raised, landmarks close to the camera drop out
OCCLUSION = 0.05  # [m] off the frame's own reading a landmark lies on another surface; raised, landmarks that are hidden take part
OCCLUSION_SHARE = 0.05  # [1] of the depth, added to it; raised, hidden landmarks that are far away take part
LEAST_SPREAD = 1e-3  # [1] of the landmarks' brightness, which divides the gain; raised, the gain of bare images is smaller
LEAST_GAIN, LARGEST_GAIN = 0.7, 1.4  # [1] change of exposure between a keyframe and a frame; wider, other differences pass as exposure
DEVIATION = 1.4826  # [1] standard deviation of a normal distribution over its median absolute deviation; a fact, not a choice

# Information of a pose by direction (`motion.Information`)
LEAST_RADIUS = 0.1  # [m] mean distance of the points by which a turn is compared with a shift; raised, turns count less close to a surface
LEAST_VALUE = 0.1  # of `hold` [1]: less information in a direction counts as this; lowered, an open direction is held more firmly
