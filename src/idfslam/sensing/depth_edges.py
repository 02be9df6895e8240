"""Where two neighbouring readings of a depth image lie on different surfaces: their depths differ by more than `EDGE + EDGE_SHARE * depth`.

Compiled kernels freeze these numbers, and Numba's cache does not notice when they change: delete it then (`idf-slam doctor` says where).
"""

EDGE = 0.02  # [m] raised, surfaces close behind one another count as one; from no paper
EDGE_SHARE = 0.03  # [1] of the depth; raised, edges far from the camera are missed, and steep surfaces are kept; from no paper
