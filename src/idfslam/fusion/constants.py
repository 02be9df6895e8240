"""Constants of the voxel blocks, shared by the plain and the compiled forms."""

BLOCK = 8  # voxels along a block's edge. More: fewer blocks, with more voxels away from surfaces. Chosen by hand
NEAREST = 0.05  # [m] least depth of a voxel in front of a camera. More: what is closer is not fused. Chosen by hand
EDGE_SHARE = 0.02  # [1] difference of neighbouring readings, of their depth, up to which depth is interpolated between them. More:
# smoother surfaces of far things, and surfaces between things that are close behind one another. Chosen by hand
ENOUGH = 64  # [1] readings a voxel, on average over a block, after which the block is left as it is, which bounds the time of long stays.
# More: slower. Less: with 16, walls of redkitchen ripple by 3.1 instead of 2.4 mm within 10 cm. Chosen by hand
FREE = 0.1  # [1] weight of a reading that says that a voxel is free, over that of one of a surface there which faces the camera, up to its
# own at its surface: a coarse image looks past thin things that others show. More: thin things vanish, and edges are worn off; less: what
# was wrongly read stays, and slots are filled. Chosen on generated rooms 1 and 2, with a Kinect's noise
LEAST_SLANT = 0.2  # [1] cosine of ray and normal below which a reading counts as this slanted. More: grazing readings count more
# [px] Edge of the tiles of a depth image whose farthest readings rule out what lies behind. More: fewer tiles are looked at, and fewer
# blocks are ruled out. Chosen by hand
TILE = 8
# [1] Part of a voxel in a point below which the voxel is left out: points of a lattice lie at voxels, up to rounding. More: distances jump
# by as much of a voxel where one enters. Chosen by hand
LEAST_PART = 1e-4
