"""Many pictures of the same samples: focal stacks and data sets, planned first and then formed."""
