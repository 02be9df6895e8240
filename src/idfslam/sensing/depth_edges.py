"""Where two neighbouring readings of depth lie on different surfaces: their depths differ by more than `EDGE + EDGE_SHARE * depth`."""

EDGE = 0.02  # [m] raised, surfaces close behind one another count as one; from no paper
EDGE_SHARE = 0.03  # [1] of the depth; raised, edges far from the camera are missed, and steep surfaces are kept; from no paper
