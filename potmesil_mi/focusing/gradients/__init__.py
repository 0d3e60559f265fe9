"""The focus stage where gradients are asked for: the same picture, as a smooth function.

What is discrete, which bins, slices and rasters there are, is chosen as it is without gradients,
and then stands still. Kernels stand at fixed circles, and what depends on the lens are weights
between them; the edges of what is seen move as parallax moves what makes them.
"""
