"""Constants of the alignment's normal equations, shared by the plain and the compiled forms. They were chosen by hand."""

# Distances to the map (`depth_term.depth_term`)
MAPPED = 0.9  # [1] share of the truncation distance within which a point takes part. Raised to 1: points in free space take part too
LEAST_SLOPE = 0.2  # [1] least length of the distance's gradient at a point that takes part. More: badly learnt places drop out
SLOPE_FLOOR = 0.7  # [1] least slope by which a distance is divided. Less: distances at flat places of the field become larger

# Brightness of landmarks (`photometric.photometric_term`)
NEAREST = 0.05  # [m] least depth of a landmark in the frame. More: landmarks close to the camera drop out
OCCLUSION = 0.05  # [m] difference to the frame's own depth from which a landmark is hidden. More: hidden landmarks take part
OCCLUSION_SHARE = 0.05  # [1] share of the depth, added to `OCCLUSION`. More: hidden landmarks that are far away take part
MASKED = 1e-3  # [m] depth that a pixel has which shows what moves: it hides all landmarks. More: nothing, up to the nearest surface
ROW_STEPS = 2  # [1] of the search for the row that sees a landmark. More: nothing; each divides the error by more than ten
LEAST_SPREAD = 1e-3  # [1] least standard deviation of the landmarks' brightness, which divides the gain. More: smaller gains of bare images
# [1] Range of the ratio of two images' contrasts, over the change of exposure. Wider: blur passes as a change of exposure: with 0.25 to 4
# steps of fr1/rpy were off by up to 8.5 degrees instead of 3.6, and 60 of 76 off frames were called good instead of 2 of 15
LEAST_GAIN, LARGEST_GAIN = 0.7, 1.4
# [1] Ratio of two images' mean brightness, and its inverse, within which their exposure counts as the same: the means differ at a wrong
# pose too. More: a lamp that goes out is sooner taken for a wrong pose
SAME_EXPOSURE = 1.2
LEAST_MEAN = 1e-3  # [1] least mean brightness of an image, which divides that of the other. More: changes of dark images count less
# [1] Range of the change of exposure. Wider: an image that is nearly black confirms any pose
LEAST_CHANGE, LARGEST_CHANGE = 0.2, 5.0
# Light that changes unevenly (`uneven_light.plain_relit`), chosen on pairs of images of generated rooms where a half darkens, a shadow or
# patches of sun move, or the camera carries a torch
# [1] Parts of the image, each of which has a gain of its own. More: sharper shadows are followed, and fewer landmarks tell of each part.
# With 6 and 4 patches of sun left poses 1.4 instead of 1.0 cm off
LIGHT_COLUMNS, LIGHT_ROWS = 8, 6
# [landmarks] that say that the light of a part has changed as the image's has. More: parts are lit less: with 10 instead of 0.3 a half that
# darkens left poses 2.1 instead of 0.1 cm off
UNCHANGED = 0.3
UNMOVED = 0.01  # [landmarks] that say that a part is not displaced. More: more of the displacement of a single edge passes for light
OUTLYING = 2.0  # [1] width of the robust kernel, in mean differences of a part. More: the edges of shadows count more
LEAST_DIFFERENCE = 1e-4  # [1] added to that width, of brightness. More: nothing, up to a step of 8 bits
# Light that flickers (`flicker.plain_flicker`), chosen on pairs of images of generated rooms 1 and 3 with bands of 0 to 50 % of the light
# [1] Bands of rows, each of which has a gain of its own. More: narrower bands of light are followed, and fewer landmarks tell of each. With
# 20 to 32 displacements at right and wrong poses are the same to 10 %
BANDS = 24
UNLIT = 1.0  # [landmarks] that say that a band has the light of the image. More: bands of few landmarks are lit less
# [1] F statistic of the gains of all bands from which they count; from twice as much on they count fully. More: weaker bands stay in the
# image. In steady light it was at most 9 at right poses and 19 at poses 2 degrees off; with bands of 10 % its median was 446 and more.
# Hand-held rooms with vignetting and automatic exposure reach 63: with 20 bands counted there, and room 2 had 1.16 instead of 0.67 cm
LEAST_EVIDENCE = 100.0
LEAST_GRADIENT = 1e-3  # [1/px] least gradient by which a difference of brightness is divided. More: bare places seem displaced less
DEVIATION = 1.4826  # [1] standard deviation of a normal distribution over its median absolute deviation: a fact, not a choice

# Information of a pose by direction (`motion.Information`)
LEAST_RADIUS = 0.1  # [m] least distance of the points by which a turn is compared with a shift. More: turns close to a surface count less
LEAST_VALUE = 0.1  # [1] least information of a direction, as a share of `prior_information`. Less: a stronger prior in an open direction

# Changes of poses (`motion.moved`)
TINY = 1e-9  # [rad] angle below which sin x = x to the last bit. More: less exact
OPPOSITE = -0.9  # [1] cosine of a turn of 154 degrees, beyond which scipy finds its axis. More: slower
