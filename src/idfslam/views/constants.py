"""How much each archived image counts at a place of a view. Compiled kernels and plain forms read these numbers from here."""

# All of these were chosen by hand, on held-out views of RedKitchen and of generated rooms.
NEAREST = 0.05  # [m] depth in front of a camera below which nothing is shown. More: close-ups have holes
AGREES = 0.03  # [m] largest distance of a place from an image's own depth at which the image sees it, plus
AGREES_SHARE = 0.01  # [1/m] this share of its squared depth, as the noise of depth grows. More: colours leak past silhouettes
ANGLE = 0.015  # [rad] between the rays of view and image to a place, over which a weight falls by e. More: more images are mixed: blurred
COARSE = 0.15  # [rad] of angle that an image counts worse if it is much farther from the place. More: near images win
MOTION = 0.06  # [rad] of motion from the view to an image over which its weight falls by e. More: images of other poses' errors are mixed
BORDER = 20.0  # [px] from an image's border over which its weight falls to nothing. Less: seams. More: fewer images at borders
NEGLIGIBLE = 0.01  # [1] share of the weights so far below which a further image is left out. More: faster, and steps where one leaves
UNREAD = 1.0  # [1] weight of an image without depth around a place, against one with. Less: where depth is missing others count more
SAME = 0.02  # [m] difference of two depths of a view up to which they are of one surface, plus
SAME_SHARE = 0.01  # [1/m] this share of the squared depth. More: thin things melt into what is behind them
OFF_EDGE = 4.0  # [px] of a depth image from its silhouettes within which its weight falls off. More: fewer images count near silhouettes
OUTLIER = 0.1  # [1] difference of a surface's colour from the mean at which an image counts half. More: ghosts. Less: seams
LEAST_COSINE = 0.1  # [1] of the angle between a surface's normal and the ray. More: slanted views colour nothing
SHARPNESS = 6  # exponent of cosine over distance, the weight of an image of a surface. More: the best image dominates: sharper, with seams
LEAST_OFF_EDGE = 0.1  # [1] weight on a silhouette itself. Less: holes there
