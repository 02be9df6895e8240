"""Values that the plain and the compiled forms of the segmentation of what moves share."""

# All of them were chosen by hand on generated rooms.
ROWS = 80  # cells in a column of a coarse view. More: finer masks, slower
SAMPLES = 3  # rows and columns of a cell whose pixels are read, at most. More: thinner things are seen, slower
SLACK = 0.03  # [m] least distance before a surface that violates its free space. More: less of what moves near a surface is found
SIGMAS = 3.0  # [1] further distance, in deviations of the two readings. More: fewer false and more missed violations
USUAL = 0.5  # [1] usual median of the differences of two views, in the sum of their deviations. More: wrong poses are noticed later
COMPARABLE = 0.15  # [m] largest difference of depth that counts as the same surface, for that. More: wrong poses are noticed sooner
STEP = 3  # every so many rows and columns of cells are compared for that. More: faster, noisier
CONTRAST = 0.05  # [1] difference of brightness beyond what a place and its neighbours show that contradicts. More: less is contradicted
LEAST_AROUND = 6  # cells of 3 x 3 that must have depth for free space to be known. More: less free space near holes
EVERYTHING = 0.85  # [1] share of violations beyond which a pose is wrong, not the scene in motion. More: larger movers, and wrong poses too
NEAREST_SEEN = 0.05  # [m] least depth of a point in another view. More: what is close to its camera is not compared
NEVER = 2**30  # [frames] age of a cell that never showed what moves: a bound that no run reaches
