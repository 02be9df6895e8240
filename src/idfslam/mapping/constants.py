"""Constants of rays and samples, shared by the plain and the compiled forms. They were chosen by hand."""

GRAZING = 0.1  # [1] least |n . d| of a surface normal and a ray. More: distances to surfaces at a grazing angle become too large
FREE_FROM = 0.05  # [m] depth at which samples in free space begin. More: the space close to the camera is not learnt
FREE_TO = 0.1  # [m] least depth at which they end. More: they reach into surfaces that are very near
